"""The chain: images -> sketch -> backbone -> lifter -> temporal -> refiner -> classifier -> class of every voxel."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Float, Float16, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Size
from omniocc.camera import Rig
from omniocc.classes import FREE
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model.hints import Known, SketchAndPixels
from omniocc.model.ops.padded import FeatureMaps, Images, by_shape, to_unit_range
from omniocc.model.ops.padding import Pointwise
from omniocc.model.protocols import (
    Backbone,
    CoarseLogits,
    Extras,
    Lifter,
    PredictsRanges,
    Refiner,
    SemanticHead,
    Sketch,
    Sketched,
    Temporal,
    Volumes,
    part_of,
    volume_and_extras,
)

SMOOTHING_FRAMES = 20.0
"""Number of frames that the class fractions of a voxel's surroundings are worth beside the voxel's own counts."""
INITIAL_STD = 0.01
"""Standard deviation of the linear map's initial weights: small, so that the first logits are nearly the start."""


class Classifier(nn.Module):
    """Add a linear map of the voxels' features to a start: log-probabilities of the classes before any feature is used.

    The start of a voxel is the frequency of every class in it over the training frames. Hints can replace the frequency
    of 'occupied' by a probability of their own, and multiply the frequencies of the occupied classes by factors. The
    frequency of each occupied class is raised to a learned power, `prior_weight`.

    Args:
        channels: number of channels of the volume.
        num_classes: number of classes of voxels, free included.

    Attributes:
        COUNTED: names of the buffers that come from counts in the training frames and are not learned.
        prior_log_odds: of being occupied.
        prior_shares: logarithms of the fractions of the occupied classes among occupied voxels.
    """

    COUNTED: ClassVar = ("prior_log_odds", "prior_shares")
    prior_log_odds: Tensor
    prior_shares: Tensor

    def __init__(self, geometry: Grid, channels: int, num_classes: int):
        super().__init__()
        self.geometry = geometry
        self.linear = Pointwise(channels, num_classes)
        nn.init.normal_(self.linear.weight, std=INITIAL_STD)
        nn.init.zeros_(self.linear.bias)
        self.prior_weight = nn.Parameter(torch.ones(num_classes - 1))
        self.register_buffer("prior_log_odds", torch.zeros(geometry.shape))
        self.register_buffer("prior_shares", torch.zeros(*geometry.shape, num_classes - 1))

    def set_class_counts(self, counts: Int64[Tensor, "K X Y Z"]) -> None:
        """Set the start from the number of training frames with each class in each voxel."""
        periodic_axes = [axis for axis in range(3) if self.geometry.periodic[axis]]
        occupied = smoothed_fractions(torch.stack([counts[FREE], counts[FREE + 1 :].sum(0)]), periodic_axes)
        self.prior_log_odds.copy_(torch.log(occupied[1] / occupied[0]))
        self.prior_shares.copy_(smoothed_fractions(counts[FREE + 1 :], periodic_axes).log().movedim(0, -1))

    def forward(self, volume: Float[Tensor, "B C X Y Z"], *hints: Tensor | None) -> Float[Tensor, "B K X Y Z"]:
        """Return logits; `hints` are the arguments of `start`."""
        return self.linear(volume) + self.start(*hints).movedim(-1, 1)

    def start(
        self, log_odds: Float[Tensor, "B X Y Z"] | None = None, class_scores: Float[Tensor, "B X Y Z O"] | None = None
    ) -> Float[Tensor, "B X Y Z K"]:
        """Return the log-probabilities before any feature of the images is used.

        Args:
            log_odds: log-odds of being occupied; None: those of the training frames.
            class_scores: scores to add to the logarithms of the frequencies of the occupied classes; None: no scores.
        """
        log_odds = self.prior_log_odds[None] if log_odds is None else log_odds
        scores = self.prior_weight * self.prior_shares[None]
        scores = scores if class_scores is None else scores + class_scores
        occupied = scores.log_softmax(-1) + F.logsigmoid(log_odds)[..., None]
        free = F.logsigmoid(-log_odds)[..., None]
        return torch.cat([free.expand(*occupied.shape[:-1], 1), occupied], dim=-1)


def smoothed_fractions(counts: Int64[Tensor, "K X Y Z"], periodic_axes: Sequence[int]) -> Float[Tensor, "K X Y Z"]:
    """Return the fraction of each class in each voxel, drawn towards that of its surroundings where frames are few.

    Surroundings are nested: the whole grid, the layer of one height, the ring along the periodic axes (if there are
    any), the voxel. From one to the next, the fractions of the larger are added to the counts of the smaller as
    `SMOOTHING_FRAMES` frames. Those of the grid are drawn towards equal fractions.

    Args:
        counts: number of frames with each class in each voxel.
        periodic_axes: periodic axes of the grid.
    """
    fractions = torch.full((len(counts), 1, 1, 1), 1 / len(counts), dtype=torch.float64)
    rings = [tuple(axis + 1 for axis in periodic_axes)] if periodic_axes else []
    for axes in [(1, 2, 3), (1, 2), *rings, ()]:
        summed = counts.double().sum(axes, keepdim=True) if axes else counts.double()
        fractions = (summed + SMOOTHING_FRAMES * fractions) / (summed.sum(0, keepdim=True) + SMOOTHING_FRAMES)
    return fractions.float()


class Prediction(NamedTuple):
    """The output of a model for the newest frame of each window.

    Attributes:
        logits: of the class of every voxel.
        pixel_logits: of the class of every pixel, at the finest feature map's size; None without a semantic head.
        range_logits: of bins of range along the rays, at the coarsest map's size; None if not requested or predicted.
        coarse_logits: of the classes of coarser cells, where lifter or refiner predict them.
        run_lengths: see `omniocc.model.protocols.Extras`; None if the refiner does not predict them.
    """

    logits: Float[Tensor, "B C X Y Z"]
    pixel_logits: Float[Tensor, "B N C h w"] | None
    range_logits: Float[Tensor, "B N D h w"] | None
    coarse_logits: tuple[CoarseLogits, ...] = ()
    run_lengths: Float[Tensor, "B 6 X Y Z"] | None = None


class Lifted(NamedTuple):
    """Features of single frames.

    Attributes:
        volume: features of every voxel, in each frame's own ego frame.
        sketched: output of the sketch, in the same ego frame.
        features: of the images, finest first.
        extras: further predictions of the lifter, which only losses use.
    """

    volume: Float[Tensor, "B C X Y Z"]
    sketched: Sketched
    features: FeatureMaps
    extras: Extras


class Window(NamedTuple):
    """The last frames of some sequences, oldest first; see `OccupancyModel.forward`."""

    images: Images
    rigs: tuple[tuple[Rig, ...], ...]
    world_from_ego: Float[Tensor, "B T 4 4"]
    sketched: Sketched | None
    exists: Bool[Tensor, "B T"]


def last_frames(
    count: int,
    images: Images,
    rigs: tuple[tuple[Rig, ...], ...],
    world_from_ego: Float[Tensor, "B T 4 4"],
    sketched: Sketched | None,
    exists: Bool[Tensor, "B T"] | None,
) -> Window:
    """Return at most `count` frames of sequences; raise ValueError if rigs and images do not fit together."""
    batch, frames = images.shape[:2]
    rig_counts = [len(sample) for sample in rigs]
    if rig_counts != [frames] * batch:
        raise ValueError(f"rigs of {rig_counts} frames for {batch} samples of {frames} frames; give one for each frame")
    if exists is None:
        exists = torch.ones(batch, frames, dtype=torch.bool, device=images.device)
    last = slice(None), slice(-count, None)
    rigs = tuple(sample[-count:] for sample in rigs)
    return Window(images[last], rigs, world_from_ego[last], sketched and part_of(sketched, *last), exists[last])


class OccupancyModel(nn.Module):
    """Predict semantic occupancy from camera images, in exchangeable parts (paper, figure 'Overall architecture').

    Samples may have different numbers of cameras and sizes of image, padded as in `omniocc.model.ops.padded`.

    Args:
        hints: what goes beyond the paper; with all its switches off this is the paper's model.
        num_classes: of voxels, free included.
    """

    def __init__(
        self,
        backbone: Backbone,
        geometry: Grid,
        sketch: Sketch,
        lifter: Lifter,
        temporal: Temporal,
        refiner: Refiner,
        semantic_head: SemanticHead,
        hints: SketchAndPixels,
        num_classes: Size,
    ):
        super().__init__()
        self.geometry = geometry
        self.backbone = backbone
        self.sketch = sketch.requires_grad_(False) if isinstance(sketch, nn.Module) else sketch
        self.lifter = lifter
        self.temporal = temporal
        self.refiner = refiner
        self.semantic_head = semantic_head
        self.hints = hints
        self.classifier = Classifier(geometry, refiner.channels, num_classes)

    def forward(
        self,
        images: Images,
        rigs: tuple[tuple[Rig, ...], ...],
        world_from_ego: Float[Tensor, "B T 4 4"],
        sketched: Sketched | None = None,
        exists: Bool[Tensor, "B T"] | None = None,
        with_ranges: bool = False,
    ) -> Prediction:
        """Return logits for the newest frame.

        Args:
            images: (B, T, N, 3, H, W), frames oldest first.
            rigs: for each sample one per frame; cameras may move on the vehicle.
            world_from_ego: pose of each frame.
            sketched: output of the sketch for every frame, with an axis T; None runs the sketch.
            exists: which frames were recorded; the others, before a scene's first, are not computed. None: all.
            with_ranges: whether to return the lifter's scores of range bins.

        Raises:
            ValueError: if rigs and images do not fit together.
        """
        window = last_frames(self.temporal.frames, images, rigs, world_from_ego, sketched, exists)
        newest_rigs = tuple(sample[-1] for sample in rigs)
        # The newest frame is lifted before the past. Under autocast, older versions of PyTorch cache weights as their
        # first use made them: without gradient, if that were the past.
        newest = self.lift(images[:, -1], newest_rigs, sketched and part_of(sketched, slice(None), -1))
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.temporal.history_gradient):
            past = self._lift_past(window, newest.volume)
        pixel_logits = self.semantic_head(newest.features)
        known = self.compute_hints(newest, newest_rigs, pixel_logits)  # beyond the paper, whose model has none
        volumes = [*past, newest.volume]
        logits, extras = self.fuse(volumes, window.world_from_ego, window.exists, newest.sketched, known)
        ranges = None
        if with_ranges and isinstance(self.lifter, PredictsRanges):
            ranges = self.lifter.range_logits(newest.features)
        coarse_logits = newest.extras.coarse_logits + extras.coarse_logits
        return Prediction(logits, pixel_logits, ranges, coarse_logits, extras.run_lengths)

    def lift(self, images: Images, rigs: tuple[Rig, ...], sketched: Sketched | None = None) -> Lifted:
        """Return the features of images and voxels of single frames; without `sketched` the sketch is run."""
        images = to_unit_range(images)
        sketched = self.propose(images, rigs) if sketched is None else sketched
        features = by_shape(lambda cropped, _: self.backbone(cropped), images, rigs, self.backbone.levels)
        volume, extras = volume_and_extras(self.lifter, features, sketched, rigs)
        check_volume(volume, self.lifter, self.lifter.channels, self.geometry)
        return Lifted(volume, sketched, features, extras)

    def fuse(
        self,
        volumes: Volumes,
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
        sketched: Sketched,
        known: Known,
    ) -> tuple[Float[Tensor, "B classes X Y Z"], Extras]:
        """Return logits of the newest frame, and what else the refiner predicts, from the lifted volumes of a window.

        Volumes, poses and `exists` are oldest first; `sketched` and `known` are those of the newest frame.
        """
        volume = self.temporal(volumes, world_from_ego, exists)
        check_volume(volume, self.temporal, self.lifter.channels, self.geometry)
        volume, extras = volume_and_extras(self.refiner, self.hints.in_volume(volume, known), sketched)
        check_volume(volume, self.refiner, self.refiner.channels, self.geometry)
        return self.classifier(volume, *self.hints.in_logits(known)), extras

    @torch.no_grad()
    def propose(self, images: Images, rigs: tuple[Rig, ...]) -> Sketched:
        """Return the output of the sketch for single frames, without gradient: it is trained in its own stage."""
        return self.sketch(to_unit_range(images), rigs)

    def compute_hints(
        self, lifted: Lifted, rigs: tuple[Rig, ...], pixel_logits: Float[Tensor, "B N K h w"] | None = None
    ) -> Known:
        """Return the hints on the voxels of single frames; run the 2D head if they need its logits and none come."""
        if pixel_logits is None and self.hints.classes is not None:
            pixel_logits = self.semantic_head(lifted.features)
        return self.hints(lifted.sketched, rigs, pixel_logits)

    def _lift_past(self, window: Window, like: Float[Tensor, "B C X Y Z"]) -> Volumes:
        """Lift all past frames that exist in one go; return zeros, laid out as `like`, for the others."""
        exists = window.exists[:, :-1]
        if exists.shape[1] == 0:
            return []
        frames, samples = exists.T.nonzero(as_tuple=True)
        lifted = like[:0]
        if len(frames):
            rigs = tuple(window.rigs[s][t] for s, t in zip(samples.tolist(), frames.tolist(), strict=True))
            sketched = window.sketched and part_of(window.sketched, samples, frames)
            lifted = self.lift(window.images[samples, frames], rigs, sketched).volume
        counts = exists.sum(0).tolist()
        parts = zip(lifted.split(counts), samples.split(counts), strict=True)
        # parts and `zeros_like` keep the memory layout, channels last
        return [
            part if len(part) == len(like) else torch.zeros_like(like).index_copy(0, sample, part)
            for part, sample in parts
        ]


def labels_of(logits: Float[Tensor, "*B C X Y Z"], occupied_above: float | None) -> UInt8[Tensor, "*B X Y Z"]:
    """Return the class of every cell.

    A cell has its most likely class, free (0) included; with `occupied_above` it has its most likely class other than
    free if it is occupied with a higher probability than this, else it is free.
    """
    if occupied_above is None:
        return logits.argmax(-4).to(torch.uint8)
    free, classes = split_free(logits)
    return (classes.argmax(-4) + 1).where(1 - free > occupied_above, 0).to(torch.uint8)


def probabilities_of(logits: Float[Tensor, "*B C X Y Z"]) -> Float16[Tensor, "*B 2 X Y Z"]:
    """Return for every cell the probability of being occupied, and of its most likely class, given that it is."""
    free, classes = split_free(logits)
    occupied = 1 - free
    return torch.stack([occupied, classes.amax(-4) / occupied.clamp(min=1e-6)], -4).half()


def split_free(
    logits: Float[Tensor, "*B C X Y Z"],
) -> tuple[Float[Tensor, "*B X Y Z"], Float[Tensor, "*B classes X Y Z"]]:
    """Return the probabilities of free and of the other classes."""
    probability = logits.float().softmax(-4)
    return probability.select(-4, FREE), probability.narrow(-4, 1, probability.shape[-4] - 1)


def check_volume(volume: Tensor, part: object, channels: int, geometry: Grid) -> None:
    """Raise UserError, naming the part of the model, unless its output has these channels and the grid's cells."""
    if volume.shape[1:] != (channels, *geometry.shape):
        name = f"{type(part).__module__}.{type(part).__name__}"
        raise UserError(
            f"{name} returned features of shape {tuple(volume.shape)}; the model needs "
            f"(samples, {channels}, {', '.join(map(str, geometry.shape))}): channels, and the cells of the grid"
        )
