"""Depth slot: the range around the ego origin, seen from several cameras."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.model.depth.mono import Mono
from omniocc.model.depth.omnimvs import OmniMVS
from omniocc.model.depth.omnimvs3d import OmniMVS3D
from omniocc.model.depth.sweep import Sweep
from omniocc.model.depth.truth import Truth
from omniocc.model.ops.depth.depth_map import DepthMap
from omniocc.model.ops.depth.spheres import Spheres

__all__ = ["Depth", "DepthMap", "Mono", "OmniMVS", "OmniMVS3D", "Spheres", "Sweep", "Truth"]


@runtime_checkable
class Depth(Protocol):
    """Estimates a panorama of ranges in the ego frame.

    Options that learn also have `training_terms(images, rigs, erp_range_m, camera_range_m, generator)`, a dict of
    weighted losses; random choices are drawn from `generator`.

    Attributes:
        panorama: directions of its pixels.
    """

    panorama: Equirectangular

    def __call__(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        true_range_m: Float[Tensor, "B h w"] | None = None,
    ) -> DepthMap:
        """The panorama from RGB in [0, 1]; only `Truth` looks at the true range (inf: sky)."""
        ...
