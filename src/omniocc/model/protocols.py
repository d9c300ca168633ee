"""The contracts between the slots of the model: what every option of a slot takes and returns.

Images of a batch are padded: a sample with fewer cameras or smaller images than others has zeros at the end of the
camera axis, at the right and at the bottom. Its rig gives the true sizes. Padding does not change the result of any
option, see `omniocc.model.ops.padded`; only the statistics of the batch norm in the 2D head (`FCN`) count it, in
training on rigs of several sizes.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model.ops.depth.depth_map import DepthMap
from omniocc.model.ops.depth.spheres import Spheres
from omniocc.model.ops.evidence import unpack_evidence
from omniocc.model.ops.padded import FeatureMaps, Images, Rigs

Volumes = list[Float[Tensor, "B C X Y Z"]]
"""Voxel features of each frame of a window, oldest first."""


class Sketched(NamedTuple):
    """The output of a sketch for single frames, or, with an axis T after B, for windows of frames.

    Attributes:
        candidates: voxels that are worth colouring.
        bits: evidence of every voxel in eight bits, see `omniocc.model.ops.evidence`; None if the sketch has none.
    """

    candidates: Bool[Tensor, "B *T X Y Z"]
    bits: UInt8[Tensor, "B *T X Y Z"] | None = None

    def evidence(self) -> Float[Tensor, "B *T 4 X Y Z"]:
        """Return the evidence of every voxel; raise UserError if the sketch has none."""
        if self.bits is None:
            raise UserError("this model uses the sketch's evidence, and its sketch has none: choose model/sketch=omni")
        return unpack_evidence(self.bits)


Fields = TypeVar("Fields", bound=tuple)
"""A named tuple of tensors that have the samples along their first axis; some may be None."""


def part_of(fields: Fields, *index: Any) -> Fields:
    """Return every field at an index of its leading axes."""
    return type(fields)(*(None if field is None else field[index] for field in fields))  # type: ignore[arg-type]


def concatenate(parts: Sequence[Fields]) -> Fields:
    """Return one batch with the samples of several; a field must be None in all of them or in none."""
    if len(parts) == 1:
        return parts[0]
    columns = zip(*parts, strict=True)
    return type(parts[0])(*(None if column[0] is None else torch.cat(column) for column in columns))  # type: ignore


class CoarseLogits(NamedTuple):
    """Classes of blocks of cells.

    Attributes:
        block: cells along each side of a block.
        logits: of each block's class; blocks at the upper ends of the grid may be smaller.
    """

    block: int
    logits: Float[Tensor, "B K _ _ _"]


class Extras(NamedTuple):
    """What a lifter or a refiner predicts besides its volume; only losses read it.

    Attributes:
        coarse_logits: classes on coarser grids.
        run_lengths: fractions of each axis's cells that follow a voxel with the same class, in the order of
            `omniocc.loss.RunLengths`; None if they are not predicted.
    """

    coarse_logits: tuple[CoarseLogits, ...] = ()
    run_lengths: Float[Tensor, "B 6 X Y Z"] | None = None


@runtime_checkable
class PredictsMore(Protocol):
    """A lifter or refiner with predictions for losses besides its volume; called alone it returns the volume."""

    def with_extras(self, *inputs: Any) -> tuple[Float[Tensor, "B C X Y Z"], Extras]:
        """Return the volume for the inputs of its slot, and the other predictions."""
        ...


def volume_and_extras(option: Callable[..., Tensor], *inputs: Any) -> tuple[Float[Tensor, "B C X Y Z"], Extras]:
    """Return the volume of a lifter or refiner, and what else it predicts, if anything."""
    return option.with_extras(*inputs) if isinstance(option, PredictsMore) else (option(*inputs), Extras())


@runtime_checkable
class Learns(Protocol):
    """An option that is trained in a stage of its own."""

    def weighted_losses(self, *args: Any) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name."""
        ...


def learns(option: type) -> bool:
    """Return whether a class of the depth or sketch slot is trained in a stage of its own; needs no object of it."""
    return issubclass(option, Learns)


@runtime_checkable
class Backbone(Protocol):
    """Turn camera images into a pyramid of feature maps.

    Attributes:
        PRETRAINED: constructor arguments that only load pretrained weights; they are set to None if a checkpoint is
            loaded afterwards.
        channels: of every map.
        levels: strides of the maps, px, finest first: an image of height H has a map of ceil(H / stride) rows.
    """

    PRETRAINED: ClassVar[tuple[str, ...]]
    channels: int
    levels: list[int]

    def __call__(self, images: Float[Tensor, "B N 3 H W"]) -> FeatureMaps:
        """Return maps that each cover the whole image, finest first, from RGB in [0, 1]."""
        ...


@runtime_checkable
class Depth(Protocol):
    """Estimate a panorama of ranges in the ego frame.

    An option that finds ranges by comparing cameras says so by `COMPARES_CAMERAS = True`.

    Attributes:
        NEEDS_TRUE_RANGE: whether the option passes on the recorded range instead of estimating it.
        panorama: directions of its pixels.
    """

    NEEDS_TRUE_RANGE: ClassVar[bool]
    panorama: Equirectangular

    def rig_spheres(self, rig: Rig) -> Spheres:
        """Return the spheres of a rig, to which `DepthMap.index` refers."""
        ...

    def __call__(self, images: Images, rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None) -> DepthMap:
        """Return the panorama from RGB; the true range (inf: sky) is used if `NEEDS_TRUE_RANGE`."""
        ...


@runtime_checkable
class LearnedDepth(Depth, Learns, Protocol):
    """A depth option with weights, trained in the depth stage.

    One whose losses use the panorama alone says so by `NEEDS_CAMERA_RANGES = False`. `ADDS_NOTHING_AT_FIRST` has the
    beginnings of names of weights that a checkpoint from which training starts may lack.
    """

    def weighted_losses(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        erp_range_m: Float[Tensor, "B h w"],
        camera_range_m: Float[Tensor, "B N H W"] | None,
        generator: torch.Generator,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name.

        Args:
            images: RGB in [0, 1].
            rigs: one per sample.
            erp_range_m: true panorama; inf for the sky, nan where unknown.
            camera_range_m: true range of every pixel; None if the data has none.
            generator: source of all random choices, on the CPU.
        """
        ...


@runtime_checkable
class Calibrates(Protocol):
    """A depth option whose confidence is fitted to the last validation."""

    def calibrate(
        self, confidence: Float[Tensor, " N"], range_m: Float[Tensor, " N"], right: Bool[Tensor, " N"]
    ) -> None:
        """Fit the confidence, from its present value and the range (m) of each ray, and whether that range is right."""
        ...


@runtime_checkable
class Sketch(Protocol):
    """Choose the candidate voxels of each sample."""

    def __call__(
        self, images: Float[Tensor, "B N 3 H W"], rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None
    ) -> Sketched:
        """Return the candidates from RGB in [0, 1] and the rig of each sample.

        The true range is for a sketch whose depth needs it.
        """
        ...


class LearnedSketch(Sketch, Learns, Protocol):
    """A sketch with weights that uses ranges, trained in the sketch stage after the depth stage.

    Ask `learns(type(sketch))` instead of `isinstance`, which from Python 3.12 on does not see `depth` as a submodule.

    Attributes:
        SELECTION: constructor arguments of the choice by probabilities; the weights do not depend on them.
        geometry: the voxel grid.
        depth: source of the ranges, frozen.
        panorama: directions of the ranges.
    """

    SELECTION: ClassVar[tuple[str, ...]]
    geometry: Grid
    depth: Depth
    panorama: Equirectangular

    def logits(self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]) -> Float[Tensor, "B 2 X Y Z"]:
        """Return scores of free and occupied for every voxel, from a panorama of ranges and where they are known."""
        ...

    def propose(self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]) -> Sketched:
        """Return candidates and evidence, from a panorama of ranges and where they are known."""
        ...

    def undilated_candidates(self, logits: Float[Tensor, "B 2 X Y Z"]) -> Bool[Tensor, "B X Y Z"]:
        """Return the cells that are candidates before they are dilated."""
        ...

    def candidates(self, logits: Float[Tensor, "B 2 X Y Z"]) -> Bool[Tensor, "B X Y Z"]:
        """Return the candidates."""
        ...

    def weighted_losses(
        self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], voxels: UInt8[Tensor, "B X Y Z"]
    ) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name; 255 in the true voxels is unknown."""
        ...


@runtime_checkable
class Lifter(Protocol):
    """Give the voxels of one frame their features.

    A lifter along rays also has `reach_m`, the distance at which the rays end, m.

    Attributes:
        channels: of the volume.
    """

    channels: int

    def __call__(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Return features of all voxels, ego frame, from feature maps (see `Backbone`), finest first."""
        ...


@runtime_checkable
class PredictsRanges(Protocol):
    """A lifter that also predicts a distribution of range for every pixel."""

    def range_logits(self, features: FeatureMaps) -> Float[Tensor, "B N D h w"]:
        """Return logits of D range bins for every pixel of the coarsest map."""
        ...


@runtime_checkable
class Temporal(Protocol):
    """Fuse a window of voxel features.

    Attributes:
        frames: length of the window, the newest frame included.
        history_gradient: whether gradients flow through past frames.
    """

    frames: int
    history_gradient: bool

    def __call__(
        self, volumes: Volumes, world_from_ego: Float[Tensor, "B T 4 4"], exists: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return one volume in the newest frame's ego frame from volumes in each frame's own, oldest first.

        Frames that do not exist (see `Batch.exists`) are ignored; the newest always exists.
        """
        ...


@runtime_checkable
class Refiner(Protocol):
    """Map voxel features to voxel features.

    Attributes:
        channels: of the volume it returns.
    """

    channels: int

    def __call__(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Return a volume on the same grid, with `channels` channels; `sketched` is the newest frame's."""
        ...


@runtime_checkable
class SemanticHead(Protocol):
    """Classify the pixels of a feature map; an option that is no head says so by `CLASSIFIES = False`."""

    def __call__(self, features: FeatureMaps) -> Float[Tensor, "B N K h w"] | None:
        """Return logits at the finest map's size, or None, from feature maps, finest first."""
        ...


def takes_true_range(sketch: Sketch) -> bool:
    """Return whether a sketch chooses candidates by recorded ranges (model/depth=truth) instead of estimated ones."""
    return learns(type(sketch)) and cast(LearnedSketch, sketch).depth.NEEDS_TRUE_RANGE
