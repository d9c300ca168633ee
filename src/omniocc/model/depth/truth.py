"""The true range: the upper bound of every depth network."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.model.ops.depth.depth_map import DepthMap, from_index, per_rig
from omniocc.model.ops.depth.panorama_depth import PanoramaDepth
from omniocc.model.ops.padded import Images, Rigs


class Truth(PanoramaDepth):
    """Return the recorded range: an upper bound for every other option."""

    NEEDS_TRUE_RANGE: ClassVar[bool] = True

    def forward(self, images: Images, rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None) -> DepthMap:
        """Return the true range; it is not valid in the sky (inf) or where it is nan.

        Raises:
            UserError: if there is no true range.
            ValueError: if it has another size than the panorama.
        """
        if true_range_m is None:
            raise UserError("model/depth=truth needs recorded ranges; this data has none: choose another model/depth")
        size = (self.panorama.height, self.panorama.width)
        if true_range_m.shape[1:] != size:
            given = tuple(true_range_m.shape[1:])
            raise ValueError(f"the true range is {given} px, the panorama {size} (height, width)")

        def one(rig: Rig, samples: list[int]) -> DepthMap:
            spheres = self.rig_spheres(rig)
            index = spheres.index(true_range_m[samples]).nan_to_num(0.0)
            seen = true_range_m[samples].isfinite()
            result = from_index(index, seen, seen.to(index), spheres)
            # the index is clamped at the nearest sphere, the range is not
            measured = true_range_m[samples].nan_to_num(spheres.farthest_m).clamp(max=spheres.farthest_m)
            return result._replace(range_m=measured)

        return per_rig(rigs, one)
