"""The true range: what a perfect depth network would give."""

from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.ops.depth.depth_map import DepthMap, from_index, per_rig
from omniocc.model.ops.depth.panoramic import Panoramic


class Truth(Panoramic):
    """Passes the recorded range through: an upper bound for everything that follows.

    Args:
        erp_size: width and height of the panorama, px.
        erp_top_deg: elevation of its upper edge.
        erp_bottom_deg: elevation of its lower edge.
        spheres: number of spheres, in whose indices the range is also given.
        min_range_m: of the nearest sphere; None derives it from each rig.

    Raises:
        ValueError: if there is no such panorama.
    """

    NEEDS_TRUE_RANGE: ClassVar[bool] = True

    def __init__(
        self,
        erp_size: Sequence[int],
        erp_top_deg: float,
        erp_bottom_deg: float,
        spheres: int,
        min_range_m: float | None,
    ):
        super().__init__(erp_size, erp_top_deg, erp_bottom_deg, spheres, min_range_m)

    def forward(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        true_range_m: Float[Tensor, "B h w"] | None = None,
    ) -> DepthMap:
        """The true range; not valid in the sky, where it is inf, and where it is nan.

        Raises:
            ValueError: if there is no true range, or one of another size than the panorama.
        """
        if true_range_m is None:
            raise ValueError(
                "model/depth=truth needs the recorded range; this data has none: choose another model/depth"
            )
        size = (self.panorama.height, self.panorama.width)
        if true_range_m.shape[1:] != size:
            raise ValueError(
                f"the true range is {tuple(true_range_m.shape[1:])} px, the panorama {size} (height, width)"
            )

        def one(rig: Rig, samples: list[int]) -> DepthMap:
            spheres = self.rig_spheres(rig)
            index = spheres.index(true_range_m[samples]).nan_to_num(0.0)
            seen = true_range_m[samples].isfinite()
            result = from_index(index, seen, seen.to(index), spheres)
            # nearer than the nearest sphere: the index is clamped, the range need not be
            measured = true_range_m[samples].nan_to_num(spheres.farthest_m).clamp(max=spheres.farthest_m)
            return result._replace(range_m=measured)

        return per_rig(rigs, one)
