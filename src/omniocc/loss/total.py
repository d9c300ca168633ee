"""The training loss: named and weighted terms, which the training step sums."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Float32, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Weight
from omniocc.classes import FREE, UNKNOWN
from omniocc.errors import UserError
from omniocc.geometry import downsample
from omniocc.loss.lidar_rays import Rays, RayWindow


@runtime_checkable
class HasLogits(Protocol):
    """The part of a prediction (`omniocc.model.Prediction`) that the losses read."""

    @property
    def logits(self) -> Float[Tensor, "B C X Y Z"]:
        """Return the logits of every voxel."""
        ...

    @property
    def pixel_logits(self) -> Float[Tensor, "B N C h w"] | None:
        """Return the logits of every pixel, or None without a semantic head."""
        ...

    @property
    def range_logits(self) -> Float[Tensor, "B N D h w"] | None:
        """Return the logits of range bins of every pixel, or None if the lifter estimates no ranges."""
        ...

    @property
    def coarse_logits(self) -> Sequence[tuple[int, Float[Tensor, "B K _ _ _"]]]:
        """Return cells along each side of a block and logits of blocks, for every coarser grid that is predicted."""
        ...

    @property
    def run_lengths(self) -> Float[Tensor, "B 6 X Y Z"] | None:
        """Return the run lengths of every voxel, or None if the refiner predicts none."""
        ...


@runtime_checkable
class WeighsClasses(Protocol):
    """A loss of voxels that weighs classes by how frequent they are."""

    def set_class_counts(self, counts: Int64[Tensor, " C"]) -> None:
        """Set the number of training voxels of each class."""
        ...


class TotalLoss(nn.Module):
    """Weighted terms by name; the loss is their sum (paper, eq. 3, where all weights are 1).

    Args:
        voxel: losses of (voxel logits, voxel labels).
        pixel: losses of (pixel logits, pixel labels).
        weights: factor of every term.
        ray: losses of (range logits, true range of every pixel), for lifters that estimate ranges.
        run: losses of (run lengths, voxel labels), for refiners that predict run lengths.
        coarse: losses of (logits of blocks, labels of blocks), means over the coarser grids that are predicted; the
            label of a block is the most frequent class of its occupied voxels (`omniocc.geometry.downsample`).

    Attributes:
        lidar: losses of (voxel logits, measured rays, generator of random choices); none here, see `RayLoss`.
        rays: measured rays from which training learns; None: it learns from voxel labels.

    Raises:
        ValueError: if the names in `weights` are not those of the terms, or a name occurs in two groups.
    """

    rays: RayWindow | None = None

    def __init__(
        self,
        voxel: Mapping[str, nn.Module],
        pixel: Mapping[str, nn.Module],
        weights: Mapping[str, Weight],
        ray: Mapping[str, nn.Module] | None = None,
        run: Mapping[str, nn.Module] | None = None,
        coarse: Mapping[str, nn.Module] | None = None,
    ):
        super().__init__()
        ray, run, coarse = ray or {}, run or {}, coarse or {}
        names = [*voxel, *pixel, *ray, *run, *coarse]
        if sorted(names) != sorted(weights):
            raise ValueError(f"loss terms {sorted(names)} and weights {sorted(weights)} must have the same names")
        self.voxel = nn.ModuleDict(dict(voxel))
        self.pixel = nn.ModuleDict(dict(pixel))
        self.ray = nn.ModuleDict(dict(ray))
        self.run = nn.ModuleDict(dict(run))
        self.coarse = nn.ModuleDict(dict(coarse))
        self.lidar = nn.ModuleDict()
        self.weights = dict(weights)

    @property
    def needs_voxels(self) -> bool:
        """Return whether there are terms of voxel labels."""
        return any(len(group) for group in (self.voxel, self.run, self.coarse))

    def ray_terms(
        self, logits: Float[Tensor, "B C X Y Z"], rays: Rays | None, generator: torch.Generator
    ) -> dict[str, Float32[Tensor, ""]]:
        """Return the weighted terms of measured rays by name; `generator` is on the CPU.

        Raises:
            UserError: if there are such terms, but no rays.
        """
        if not len(self.lidar):
            return {}
        if rays is None:
            raise UserError("loss=lidar_rays needs LiDAR scans, which these frames lack; loss=paper needs voxel labels")
        return {name: self.weights[name] * loss(logits, rays, generator) for name, loss in self.lidar.items()}

    def set_class_counts(self, counts: Int64[Tensor, " C"]) -> None:
        """Set the number of training voxels of each class in the losses that weigh classes."""
        for loss in (*self.voxel.values(), *self.coarse.values()):
            if isinstance(loss, WeighsClasses):
                loss.set_class_counts(counts)

    def forward(
        self,
        prediction: HasLogits,
        voxels: UInt8[Tensor, "B X Y Z"] | None,
        pixel_labels: UInt8[Tensor, "B N H W"] | None,
        camera_range_m: Float[Tensor, "B N H W"] | None = None,
    ) -> dict[str, Float32[Tensor, ""]]:
        """Return weighted scalar terms by name; labels that are absent (None) give no terms.

        Unknown labels are 255, unknown ranges (m) nan. `pixel_labels` are used only if the model predicts pixels, and
        `camera_range_m` only if there are terms of rays.

        Raises:
            UserError: if there are terms of rays, runs or coarser grids, but the model predicts none.
        """
        terms = {}
        if voxels is not None:
            terms |= {name: loss(prediction.logits, voxels) for name, loss in self.voxel.items()}
        if prediction.pixel_logits is not None and pixel_labels is not None:
            terms |= {name: loss(prediction.pixel_logits, pixel_labels) for name, loss in self.pixel.items()}
        if len(self.ray) and camera_range_m is not None:
            if prediction.range_logits is None:
                raise UserError("loss=with_ranges needs a lifter that estimates ranges: model/lifter=lift_splat")
            terms |= {name: loss(prediction.range_logits, camera_range_m) for name, loss in self.ray.items()}
        if len(self.run) and voxels is not None:
            if prediction.run_lengths is None:
                raise UserError("loss=with_run_lengths needs a refiner that predicts them: model/refiner=focus")
            terms |= {name: loss(prediction.run_lengths, voxels) for name, loss in self.run.items()}
        if len(self.coarse) and voxels is not None:
            terms |= self._coarse_terms(prediction.coarse_logits, voxels)
        return {name: self.weights[name] * term for name, term in terms.items()}

    def _coarse_terms(
        self, coarse_logits: Sequence[tuple[int, Tensor]], voxels: UInt8[Tensor, "B X Y Z"]
    ) -> dict[str, Float32[Tensor, ""]]:
        if not coarse_logits:
            raise UserError("loss=with_coarse needs a model that classifies blocks: model=oneocc or model=adaptiveocc")
        pairs = [(logits, labels_of_blocks(voxels, block, logits.shape[1])) for block, logits in coarse_logits]
        return {name: torch.stack([loss(*pair) for pair in pairs]).mean() for name, loss in self.coarse.items()}


class RayLoss(TotalLoss):
    """Terms that learn from measured rays, without voxel labels.

    Terms of voxels get labels that the rays vote (`omniocc.data.labels.ray_votes`), terms of rays the rays themselves.
    Other arguments as in `TotalLoss`.

    Args:
        lidar: losses of (voxel logits, measured rays, generator of random choices).
        rays: which rays a frame is trained on.

    Raises:
        ValueError: as `TotalLoss`, or if there are terms of voxels, but rays without classes.
    """

    def __init__(
        self,
        voxel: Mapping[str, nn.Module],
        pixel: Mapping[str, nn.Module],
        weights: Mapping[str, Weight],
        lidar: Mapping[str, nn.Module],
        rays: RayWindow,
        ray: Mapping[str, nn.Module] | None = None,
        run: Mapping[str, nn.Module] | None = None,
        coarse: Mapping[str, nn.Module] | None = None,
    ):
        # the names of all terms are checked together
        super().__init__(voxel, {**pixel, **lidar}, weights, ray, run, coarse)
        self.pixel, self.lidar = nn.ModuleDict(dict(pixel)), nn.ModuleDict(dict(lidar))
        self.rays = rays
        if self.needs_voxels and not rays.classes:
            raise ValueError("rays.classes is false, but terms of voxels need classes; use terms of rays alone")


def labels_of_blocks(voxels: UInt8[Tensor, "B X Y Z"], block: int, num_classes: int) -> UInt8[Tensor, "B x y z"]:
    """Return the classes of blocks of `block` cells along each axis; those at the upper ends may be smaller."""
    missing = [-size % block for size in reversed(voxels.shape[1:])]
    padding = [cells for size in missing for cells in (0, size)]

    def count(cells: Bool[Tensor, "B X Y Z"]) -> Float[Tensor, "B x y z"]:
        return F.avg_pool3d(F.pad(cells.float(), padding).unsqueeze(1), block).squeeze(1) * block**3

    joined = downsample(F.pad(voxels, padding, value=FREE), block, num_classes)
    unknown = 2 * count(voxels == UNKNOWN) > count(torch.ones_like(voxels, dtype=torch.bool)) + 0.5  # of real cells
    return joined.masked_fill((joined == FREE) & unknown, UNKNOWN)
