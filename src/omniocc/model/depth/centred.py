"""Ranges computed around the middle height of the cameras, and re-projected to the ego origin."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.depth.omnimvs import OmniMVS
from omniocc.model.ops.depth.depth_map import DepthMap
from omniocc.model.ops.depth.z_buffer import reproject
from omniocc.model.ops.rig_cache import once_per_rig


@once_per_rig
def at_cameras(rig: Rig) -> tuple[Rig, float]:
    """Return the rig with its origin as high as its cameras are on average, and how much higher that is, m."""
    height_m = float(rig.ego_from_camera[:, 2, 3].mean())
    return rig.raised(height_m), height_m


class Centred(OmniMVS):
    """Compute ranges as `OmniMVS` does around the mean height of the cameras, and re-project them to the ego origin.

    It is for weights of rigs whose origin lay among their cameras, and rigs whose origin does not: voxels need the road
    at one height below the origin. The losses are those of `OmniMVS`, of ranges around the ego origin. Arguments as in
    `OmniMVS`.
    """

    LEAVES_RAYS_OUT: ClassVar[bool] = True
    """Rays on which no re-projected point falls have no range; errors of range do not count them."""

    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        centred, height_m = at_cameras(rig)
        return reproject(super().estimate(images, centred), self.panorama, self.rig_spheres(rig), height_m)
