"""Temporal self-attention to the previous bird's-eye view, aligned (BEVFormer)."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera.pose import invert_pose
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import coarsened
from omniocc.model.ops.deformable_attention import SampledAttention, ring_offsets, transposed, unravel
from omniocc.model.ops.feedforward import AttentionLayer
from omniocc.model.ops.padding import Periodic, pad3d
from omniocc.model.ops.static import is_static
from omniocc.model.protocols import Volumes

VIEWS = 2
"""The previous and the present one."""


class TemporalAttention(SampledAttention):
    """Sum samples around every cell of a bird's-eye view, half from the previous view, half from the present one.

    Offsets and weights are computed from the cell's features in both (Li et al., 2022, 'BEVFormer', eq. 5).

    Args:
        channels: of the views.
        heads: a divisor of the channels.
        points: samples per head and view.
    """

    def __init__(self, channels: int, heads: int, points: int):
        rings = ring_offsets(heads, VIEWS, points, anchors=1).permute(2, 0, 1, 3)
        super().__init__(channels, VIEWS * channels, heads, rings, axes=2)
        self.points = points

    def forward(
        self, present: Float[Tensor, "B X Y C"], previous: Float[Tensor, "B X Y C"], periodic: Periodic
    ) -> Float[Tensor, "B X Y C"]:
        """Return the change of the present view."""
        with torch.autocast(present.device.type, enabled=False):
            dtype = torch.promote_types(present.dtype, torch.float32)
            views = torch.stack([previous, present], dim=1).to(dtype)
            offsets, weights = self._sampling(torch.cat([previous, present], dim=-1).to(dtype).flatten(0, 2))
            cells = present.shape[1:3]
            sample, place = unravel(0, len(weights), cells, weights.device)
            view = torch.arange(VIEWS, dtype=torch.int32, device=sample.device).repeat_interleave(self.points)
            begin = (sample[:, None, None] * VIEWS + view) * math.prod(count + 2 for count in cells)
            places, table = place[:, :, None, None] + offsets, self._table(views, periodic)
            sums = self.sum_among_cells(table, places, weights, begin, cells, periodic[:2])
        return self.output(sums.view(present.shape))

    def _table(self, views: Float[Tensor, "B 2 X Y C"], periodic: Periodic) -> Float[Tensor, "R D"]:
        """Return values by sample, view, cell and head, with one cell more at every end, as `corners` needs."""
        values = self.value(views).flatten(0, 1).movedim(-1, 1).unsqueeze(-1)
        return pad3d(values, (1, 1, 0), periodic).movedim(1, -1).reshape(-1, views.shape[-1] // self.heads)

    def _sampling(self, queries: Float[Tensor, "N E"]) -> tuple[Float[Tensor, "2 N H K"], Float[Tensor, "N H K"]]:
        offsets = self.offsets(queries).view(len(queries), 2, self.heads, -1).transpose(0, 1)
        weights = transposed(self.attention, queries).view(self.heads, VIEWS, self.points, -1).softmax(2) / VIEWS
        return offsets, weights.flatten(1, 2).permute(2, 0, 1).contiguous()


class History(NamedTuple):
    """Past of each sample.

    Attributes:
        view: after attention.
        pose: world_from_ego of its frame.
        exists: whether there is any past.
    """

    view: Float[Tensor, "B X Y C"]
    pose: Float[Tensor, "B 4 4"]
    exists: Bool[Tensor, " B"]


class Recurrent(nn.Module):
    """Let each bird's-eye view attend to the previous one, from the oldest frame to the newest.

    As in BEVFormer (Li et al., 2022), the result of a frame, moved into the next one's ego frame, is the history of the
    next; a frame without history attends to itself. BEVFormer has this attention in every layer of its encoder, here it
    follows the whole encoder. Volumes become views by a linear map of each column of voxels, and the newest view is
    mapped back and added to the newest volume.

    Args:
        channels: of the volumes.
        view_channels: of the views.
        layers: of attention, each followed by a feed-forward part.
        heads: of attention, a divisor of `view_channels`.
        points: samples per head and view.
        feedforward_channels: hidden channels of the feed-forward part.
        frames: of a window, the newest included.
        history_gradient: whether gradients also flow through past frames; in BEVFormer they do not.

    Raises:
        ValueError: if there are no past frames, or the heads do not divide the channels.
    """

    def __init__(
        self,
        geometry: Grid,
        channels: Size,
        view_channels: Size,
        layers: Count,
        heads: Count,
        points: Count,
        feedforward_channels: Size,
        frames: Count,
        history_gradient: bool,
    ):
        super().__init__()
        if frames < 2:
            raise ValueError(f"frames is {frames}; a window needs at least 2; without history: model/temporal=none")
        self.view = coarsened(geometry, (1, 1, geometry.shape[2]))
        self.frames = frames
        self.history_gradient = history_gradient
        self.fold = nn.Linear(geometry.shape[2] * channels, view_channels)
        self.unfold = nn.Linear(view_channels, geometry.shape[2] * channels)
        self.layers = nn.ModuleList(
            AttentionLayer(TemporalAttention(view_channels, heads, points), view_channels, feedforward_channels)
            for _ in range(layers)
        )

    def forward(
        self, volumes: Volumes, world_from_ego: Float[Tensor, "B T 4 4"], exists: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return the newest volume, changed by the past."""
        *past, newest = volumes
        poses = world_from_ego.double()
        device, learns = newest.device.type, torch.is_grad_enabled() and self.history_gradient
        # older versions of PyTorch cache weights for autocast without gradient if their first use needs none
        dtype, enabled = torch.get_autocast_dtype(device), torch.is_autocast_enabled(device)
        cast = torch.autocast(device, dtype, enabled, cache_enabled=learns)
        with torch.set_grad_enabled(learns), cast:
            history = self._remember(past, poses, exists)
        view = self._attend(newest, poses[:, -1], history)
        change = self.unfold(view).unflatten(-1, (newest.shape[-1], -1)).movedim(-1, 1)
        return newest + change

    def _remember(self, past: Volumes, poses: Float[Tensor, "B T 4 4"], exists: Bool[Tensor, "B T"]) -> History | None:
        """Go through the frames before the newest; each sample keeps its last view that exists."""
        history: History | None = None
        for volume, pose, exist in zip(past, poses.unbind(1), exists.unbind(1), strict=False):
            if not is_static() and not exist.any():
                continue
            view = self._attend(volume, pose, history)
            if history is not None:
                view = torch.where(exist[:, None, None, None], view, history.view)
                pose = torch.where(exist[:, None, None], pose, history.pose)
                exist = exist | history.exists
            history = History(view, pose, exist)
        return history

    def _attend(
        self, volume: Float[Tensor, "B C X Y Z"], pose: Float[Tensor, "B 4 4"], history: History | None
    ) -> Float[Tensor, "B X Y D"]:
        present = self.fold(volume.movedim(1, -1).flatten(-2))
        previous = present
        if history is not None:
            moved = self.view.warp(history.view.movedim(-1, 1).unsqueeze(-1), invert_pose(history.pose) @ pose)
            previous = torch.where(history.exists[:, None, None, None], moved[..., 0].movedim(1, -1), present)
        for layer in self.layers:
            present = layer(present, previous, self.view.periodic)
        return present
