"""Cylinder sketch: candidates from omnidirectional depth (paper, section IV-B)."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Count, Metres, Size
from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Grid
from omniocc.loss import Lovasz
from omniocc.model.ops.evidence import pack_evidence, sight_of
from omniocc.model.ops.padded import Rigs
from omniocc.model.ops.sketch import GAP_CHANNELS, Cylinder3D, PointEncoder, RangeGaps, non_periodic_axes, pseudo_points
from omniocc.model.protocols import Depth, Sketched


def occupancy(voxels: UInt8[Tensor, "B X Y Z"]) -> UInt8[Tensor, "B X Y Z"]:
    """Return 0 for free, 1 for occupied by any class, 255 for unknown."""
    return torch.where(voxels == UNKNOWN, voxels, (voxels != FREE).to(torch.uint8))


def cell_coordinates(geometry: Grid) -> Float[Tensor, "A X Y Z"]:
    """Return the coordinates of each cell along the axes that do not wrap around, from -1 to 1."""
    middles = [(2 * torch.arange(cells) + 1) / cells - 1 for cells in geometry.shape]
    grids = torch.meshgrid(*middles, indexing="ij")
    return torch.stack([grids[axis] for axis in non_periodic_axes(geometry)])


def log_odds(logits: Float[Tensor, "B 2 X Y Z"]) -> Float32[Tensor, "B X Y Z"]:
    """Return the log-odds of being occupied."""
    free, occupied = logits.float().unbind(1)
    return occupied - free


def choose_likeliest(probability: Float[Tensor, "B X Y Z"], fraction: float) -> Bool[Tensor, "B X Y Z"]:
    """Return the round(fraction * cells) likeliest cells of each sample, ties included in this number."""
    cells = probability.flatten(1)
    chosen = cells.topk(round(fraction * cells.shape[1]), dim=1, sorted=False).indices
    return torch.zeros_like(cells, dtype=torch.bool).scatter_(1, chosen, True).reshape(probability.shape)


class Omni(nn.Module):
    """Choose the voxels that a panorama of ranges makes likely to be occupied.

    Ranges -> points and range gaps of every cell -> probability of being occupied -> candidates. The depth network is
    frozen and in evaluation mode.

    Args:
        depth: ranges of a panorama around the ego origin.
        point_channels: number of features that the points in a cell give it.
        samples: number of points of each cell along each axis, whose distances are compared with the panorama.
        channels: of each level of the network, finest first; multiples of 8.
        threshold: smallest probability of candidates, above 0 and at most 1; None uses `fraction`.
        fraction: of cells that are candidates, the likeliest first, above 0 and at most 1; None uses `threshold`.
        dilation_m: for each band, distance by which candidates are dilated towards and away from the z axis, rounded to
            whole cells; 0: not at all.
        band_edges_m: horizontal distances at which one band ends and the next begins, one fewer than `dilation_m`.
        dilation_behind_m: distance by which candidates are dilated further, away from the z axis only, rounded to whole
            cells.

    Raises:
        ValueError: unless one of threshold and fraction is given and in range, or if sizes do not fit.
    """

    SELECTION: ClassVar = ("threshold", "fraction", "dilation_m", "band_edges_m", "dilation_behind_m")

    coordinates: Tensor

    def __init__(
        self,
        geometry: Grid,
        depth: Depth,
        point_channels: Size,
        samples: Sequence[Count],
        channels: list[Size],
        threshold: float | None,
        fraction: float | None,
        dilation_m: Sequence[Metres],
        band_edges_m: Sequence[Metres],
        dilation_behind_m: Metres = 0.0,
    ):
        super().__init__()
        if (threshold is None) == (fraction is None):
            raise ValueError(f"threshold is {threshold} and fraction is {fraction}; give one and set the other to null")
        limit = fraction if threshold is None else threshold
        if not 0 < limit <= 1:  # type: ignore[operator]
            raise ValueError(f"threshold or fraction is {limit}; use 0 < value <= 1")
        windows = [round(window_m / geometry.radial_step_m) for window_m in dilation_m]
        behind = round(dilation_behind_m / geometry.radial_step_m)
        # raises ValueError unless windows and bands fit
        geometry.dilate(torch.zeros(geometry.shape, dtype=torch.bool), windows, band_edges_m, behind)
        assert isinstance(depth, nn.Module)
        self.geometry = geometry
        self.threshold, self.fraction = threshold, fraction
        self.windows, self.band_edges_m, self.behind = tuple(windows), tuple(band_edges_m), behind
        self.panorama = depth.panorama
        self.depth = depth.requires_grad_(False).eval()
        self.points = PointEncoder(geometry, point_channels)
        self.range_gaps = RangeGaps(geometry, self.panorama, samples)
        self.register_buffer("coordinates", cell_coordinates(geometry), persistent=False)
        inputs = point_channels + 1 + GAP_CHANNELS + len(self.coordinates)
        self.network = Cylinder3D(geometry, inputs, channels, 2)
        self.lovasz = Lovasz()

    def train(self, mode: bool = True) -> "Omni":
        """Set the mode of all parts but `depth`, which stays in evaluation mode."""
        super().train(mode)
        self.depth.eval()
        return self

    def forward(
        self, images: Float[Tensor, "B N 3 H W"], rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None
    ) -> Sketched:
        """Return the candidates; true ranges are for a depth option that needs them."""
        with torch.no_grad():
            seen = self.depth(images, rigs, true_range_m)
        return self.propose(seen.range_m, seen.valid)

    def logits(self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]) -> Float[Tensor, "B 2 X Y Z"]:
        """Return scores of free and occupied for every cell from a panorama of ranges; invalid ranges are ignored."""
        return self._logits_and_sight(range_m, valid)[0]

    def propose(self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]) -> Sketched:
        """Return candidates and evidence from a panorama of ranges; invalid ranges are ignored."""
        logits, sight = self._logits_and_sight(range_m, valid)
        return Sketched(self.candidates(logits), pack_evidence(log_odds(logits), sight))

    def _logits_and_sight(
        self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]
    ) -> tuple[Float[Tensor, "B 2 X Y Z"], UInt8[Tensor, "B X Y Z"]]:
        encoded, hit = self.points(pseudo_points(range_m, valid, self.panorama))
        gaps = self.range_gaps(range_m, valid)
        coordinates = self.coordinates.expand(len(range_m), *self.coordinates.shape)
        logits = self.network(torch.cat([encoded, hit, gaps, coordinates], dim=1))
        return logits, sight_of(hit[:, 0] > 0, known=gaps[:, 0], gap=gaps[:, 2])

    def undilated_candidates(self, logits: Float[Tensor, "B 2 X Y Z"]) -> Bool[Tensor, "B X Y Z"]:
        """Return the candidates before they are dilated."""
        probability = logits.detach().float().softmax(1)[:, 1]
        if self.threshold is not None:
            return probability >= self.threshold
        assert self.fraction is not None
        return choose_likeliest(probability, self.fraction)

    def candidates(self, logits: Float[Tensor, "B 2 X Y Z"]) -> Bool[Tensor, "B X Y Z"]:
        """Return the candidates, dilated."""
        return self.geometry.dilate(self.undilated_candidates(logits), self.windows, self.band_edges_m, self.behind)

    def weighted_losses(
        self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], voxels: UInt8[Tensor, "B X Y Z"]
    ) -> dict[str, Float32[Tensor, ""]]:
        """Return cross-entropy and Lovász loss of free against occupied; 255 is ignored."""
        logits, target = self.logits(range_m, valid).float(), occupancy(voxels)
        known = (target != UNKNOWN).sum().clamp(min=1)
        ce = F.cross_entropy(logits, target.long(), ignore_index=UNKNOWN, reduction="sum") / known
        return {"ce": ce, "lovasz": self.lovasz(logits, target)}
