"""Mean of aligned volumes (paper, section III-D, eq. 2)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.camera.pose import invert_pose
from omniocc.geometry import Grid


class Mean(nn.Module):
    """Takes every past volume into the newest ego frame and averages, cell by cell.

    The paper divides by N + 1 everywhere. Here a cell's mean runs over the frames that saw it: those that exist (a
    scene's first frames have fewer before them) and whose grid holds the cell's centre.

    Args:
        geometry: the voxel grid.
        frames: of a window, the newest included: N + 1.
        history_gradient: whether training reaches the network also through the past frames, as the newest; costs the
            memory of as many frames.

    Raises:
        ValueError: if there are no past frames.
    """

    def __init__(self, geometry: Grid, frames: int, history_gradient: bool):
        super().__init__()
        if frames < 2:
            raise ValueError(f"frames is {frames}; a window needs at least 2, without past frames use NoTemporal")
        self.geometry = geometry
        self.frames = frames
        self.history_gradient = history_gradient

    def forward(
        self,
        volumes: list[Float[Tensor, "B C X Y Z"]],
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
    ) -> Float[Tensor, "B C X Y Z"]:
        """The mean in the newest frame; alone, the newest volume itself, bit for bit."""
        *past, total = volumes
        count = torch.ones_like(total[:, :1])
        for volume, pose, there in zip(past, world_from_ego.unbind(1), exists.unbind(1), strict=False):
            past_from_current = invert_pose(pose.double()) @ world_from_ego[:, -1].double()
            there = there[:, None, None, None, None]
            inside = self.geometry.warp_valid(past_from_current).unsqueeze(1)
            total = total.addcmul(self.geometry.warp(volume, past_from_current), there.to(total.dtype))  # 0 outside
            count = count + (inside & there)
        return total / count
