"""Mean of aligned volumes (paper, section IV-E, eq. 2)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.bounds import Count
from omniocc.camera.pose import invert_pose
from omniocc.geometry import Grid
from omniocc.model.ops.static import is_static
from omniocc.model.protocols import Volumes
from rayiou.warp import interpolate


class Mean(nn.Module):
    """Move every past volume into the newest ego frame and average cell by cell.

    The paper divides by N + 1 everywhere. Here a cell's mean is over the frames that exist (fewer at the beginning of
    a scene) and whose grid holds the cell's centre.

    Args:
        frames: of a window, the newest included: N + 1.
        history_gradient: whether gradients also flow through past frames, which takes memory for each.

    Raises:
        ValueError: if there are no past frames.
    """

    def __init__(self, geometry: Grid, frames: Count, history_gradient: bool):
        super().__init__()
        if frames < 2:
            raise ValueError(f"frames is {frames}; a window needs at least 2; without history: model/temporal=none")
        self.geometry = geometry
        self.frames = frames
        self.history_gradient = history_gradient

    def forward(
        self, volumes: Volumes, world_from_ego: Float[Tensor, "B T 4 4"], exists: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return the mean in the newest frame; without past frames the newest volume itself."""
        *past, newest = volumes
        if not past:
            return newest
        total = torch.zeros_like(newest)  # keeps channels last in memory
        count = newest.new_ones(len(newest), 1, *self.geometry.shape)
        # in float64: at coordinates of 500 km, as UTM has them, float32 has steps of 3 cm
        past_from_current = invert_pose(world_from_ego[:, :-1].double()) @ world_from_ego[:, -1:].double()
        for frame, sample in present_frames(exists[:, :-1]):
            rows = past[frame][sample].movedim(0, -1).flatten(0, 2)
            corners = self.geometry.corners(past_from_current[sample, frame].to(rows.device), rows.dtype)
            present = exists[sample, frame]
            moved = interpolate(rows, corners._replace(weights=corners.weights * present))
            total[sample].add_(moved.unflatten(0, self.geometry.shape).movedim(-1, 0))
            count[sample, 0].add_((corners.inside & present).unflatten(0, self.geometry.shape))
        return (total + newest) / count


def present_frames(exists: Bool[Tensor, "B P"]) -> list[tuple[int, int]]:
    """Return (frame, sample) of all frames that exist, or of all where shapes must not depend on the data."""
    samples, frames = exists.shape
    rows = [[True] * samples] * frames if is_static() else exists.T.tolist()
    return [(frame, sample) for frame, row in enumerate(rows) for sample, present in enumerate(row) if present]
