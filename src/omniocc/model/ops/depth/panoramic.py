"""What all depth options share: their panorama, and the spheres in whose indices they answer."""

from collections.abc import Sequence
from typing import ClassVar

from torch import nn

from omniocc.camera import Rig
from omniocc.model.ops.depth.depth_map import make_panorama
from omniocc.model.ops.depth.spheres import Spheres, rig_spheres


class Panoramic(nn.Module):
    """A depth option; subclasses say how it answers.

    Args:
        erp_size: width and height of the panorama, px.
        erp_top_deg: elevation of its upper edge.
        erp_bottom_deg: elevation of its lower edge.
        spheres: number of spheres.
        min_range_m: of the nearest sphere; None derives it from each rig.

    Raises:
        ValueError: if there is no such panorama.
    """

    NEEDS_TRUE_RANGE: ClassVar[bool] = False

    def __init__(
        self,
        erp_size: Sequence[int],
        erp_top_deg: float,
        erp_bottom_deg: float,
        spheres: int,
        min_range_m: float | None,
    ):
        super().__init__()
        self.panorama = make_panorama(erp_size, erp_top_deg, erp_bottom_deg)
        self.spheres, self.min_range_m = spheres, min_range_m

    def rig_spheres(self, rig: Rig) -> Spheres:
        """What indices mean with this rig."""
        return rig_spheres(rig, self.panorama, self.spheres, self.min_range_m)
