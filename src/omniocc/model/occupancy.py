"""The chain: images -> sketch -> backbone -> lifter -> temporal -> refiner -> classifier -> class of every voxel."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
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
    GuessesRanges,
    Lifter,
    Refiner,
    SemanticHead,
    Sketch,
    Sketched,
    Temporal,
    Volumes,
    part_of,
    volume_and_extras,
)

SMOOTHING = 20.0
"""Frames by which the counts of a voxel's neighbours count in its own."""
FIRST_WEIGHTS = 0.01
"""Standard deviation of the linear map's first weights: small, so that the first logits are the start."""


class Classifier(nn.Module):
    """Add a linear map of the voxels' features to a start: the log-probabilities of the classes before training.

    The start has the frequencies of the classes in each voxel of the training frames. Hints may put a probability of
    their own in the place of the frequency of being occupied, and multiply the frequencies of the occupied classes. How
    much a frequency counts is learned for each class.

    Args:
        channels: of the volume.
        num_classes: of voxels, free included.

    Attributes:
        COUNTED: names of the buffers that are counted in the training frames, not learned.
    """

    COUNTED: ClassVar = ("prior_log_odds", "prior_shares")
    prior_log_odds: Tensor
    prior_shares: Tensor

    def __init__(self, geometry: Grid, channels: int, num_classes: int):
        super().__init__()
        self.geometry = geometry
        self.linear = Pointwise(channels, num_classes)
        nn.init.normal_(self.linear.weight, std=FIRST_WEIGHTS)
        nn.init.zeros_(self.linear.bias)
        self.prior_weight = nn.Parameter(torch.ones(num_classes - 1))
        self.register_buffer("prior_log_odds", torch.zeros(geometry.shape))
        self.register_buffer("prior_shares", torch.zeros(*geometry.shape, num_classes - 1))

    def set_class_counts(self, counts: Int64[Tensor, "K X Y Z"]) -> None:
        """Set the start from the number of training frames with each class in each voxel."""
        rings = [axis for axis in range(3) if self.geometry.periodic[axis]]
        occupied = smoothed_fractions(torch.stack([counts[FREE], counts[FREE + 1 :].sum(0)]), rings)
        self.prior_log_odds.copy_(torch.log(occupied[1] / occupied[0]))
        self.prior_shares.copy_(smoothed_fractions(counts[FREE + 1 :], rings).log().movedim(0, -1))

    def forward(self, volume: Float[Tensor, "B C X Y Z"], *hints: Tensor | None) -> Float[Tensor, "B K X Y Z"]:
        """Return logits; hints are those of `start`."""
        return self.linear(volume) + self.start(*hints).movedim(-1, 1)

    def start(
        self, log_odds: Float[Tensor, "B X Y Z"] | None = None, class_scores: Float[Tensor, "B X Y Z O"] | None = None
    ) -> Float[Tensor, "B X Y Z K"]:
        """Return the log-probabilities before any feature of the images is used.

        Args:
            log_odds: of being occupied; None: those of the training frames.
            class_scores: of the occupied classes, added to the logarithms of their frequencies; None: nothing is.
        """
        log_odds = self.prior_log_odds[None] if log_odds is None else log_odds
        scores = self.prior_weight * self.prior_shares[None]
        scores = scores if class_scores is None else scores + class_scores
        occupied = scores.log_softmax(-1) + F.logsigmoid(log_odds)[..., None]
        free = F.logsigmoid(-log_odds)[..., None]
        return torch.cat([free.expand(*occupied.shape[:-1], 1), occupied], dim=-1)


def smoothed_fractions(counts: Int64[Tensor, "K X Y Z"], rings: Sequence[int]) -> Float[Tensor, "K X Y Z"]:
    """Return the fraction of each class in each voxel, drawn towards that of its surroundings where frames are few.

    The surroundings of a voxel are its ring along the periodic axes, those of a ring its height, those of a height the
    whole grid, those of the grid equal fractions. Each is worth 20 frames. In a grid without periodic axes those of a
    voxel are its height.

    Args:
        counts: frames with each class in each voxel.
        rings: periodic axes of the grid.
    """
    fractions = torch.full((len(counts), 1, 1, 1), 1 / len(counts), dtype=torch.float64)
    wholes = [(1, 2, 3), (1, 2), *([tuple(axis + 1 for axis in rings)] if rings else []), ()]
    for axes in wholes:
        summed = counts.double().sum(axes, keepdim=True) if axes else counts.double()
        fractions = (summed + SMOOTHING * fractions) / (summed.sum(0, keepdim=True) + SMOOTHING)
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
        sketched: the candidates, in the same ego frame.
        features: of the images, finest first.
        extras: what the lifter predicts for losses besides.
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
    given, (batch, frames) = [len(sample) for sample in rigs], images.shape[:2]
    if given != [frames] * batch:
        raise ValueError(f"rigs of {given} frames for {batch} samples of {frames} frames; give one for each frame")
    if exists is None:
        exists = torch.ones(batch, frames, dtype=torch.bool, device=images.device)
    part = slice(None), slice(-count, None)
    rigs = tuple(sample[-count:] for sample in rigs)
    return Window(images[part], rigs, world_from_ego[part], sketched and part_of(sketched, *part), exists[part])


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
            rigs: of each sample one per frame; cameras may move on the vehicle.
            world_from_ego: pose of each frame.
            sketched: output of the sketch for every frame, with an axis T; None runs the sketch.
            exists: which frames were recorded; the others, before a scene's first, are not computed. None: all.
            with_ranges: whether to return the lifter's scores of range bins.

        Raises:
            ValueError: if rigs and images do not fit together.
        """
        window = last_frames(self.temporal.frames, images, rigs, world_from_ego, sketched, exists)
        newest_rigs = tuple(sample[-1] for sample in rigs)
        # candidates from depth -> image features -> coloring; the newest frame first: older versions of PyTorch cache
        # weights for autocast as their first use needs them, and the past may need no gradient
        newest = self.lift(images[:, -1], newest_rigs, sketched and part_of(sketched, slice(None), -1))
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.temporal.history_gradient):
            past = self._lift_past(window, newest.volume)
        pixel_logits = self.semantic_head(newest.features)
        # beyond the paper, whose model knows nothing here
        known = self.known(newest, newest_rigs, pixel_logits)
        # temporal fusion -> refiner -> classifier
        volumes = [*past, newest.volume]
        logits, extras = self.fuse(volumes, window.world_from_ego, window.exists, newest.sketched, known)
        ranges = None
        if with_ranges and isinstance(self.lifter, GuessesRanges):
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

    def known(
        self, lifted: Lifted, rigs: tuple[Rig, ...], pixel_logits: Float[Tensor, "B N K h w"] | None = None
    ) -> Known:
        """Return the hints on the voxels of single frames; the 2D head is run if they use its logits and have none."""
        if pixel_logits is None and self.hints.classes is not None:
            pixel_logits = self.semantic_head(lifted.features)
        return self.hints(lifted.sketched, rigs, pixel_logits)

    def _lift_past(self, window: Window, like: Float[Tensor, "B C X Y Z"]) -> Volumes:
        """Lift all past frames that exist in one go; return zeros, laid out as `like`, for the others."""
        there = window.exists[:, :-1]
        if there.shape[1] == 0:
            return []
        frames, samples = there.T.nonzero(as_tuple=True)
        lifted = like[:0]
        if len(frames):
            rigs = tuple(window.rigs[s][t] for s, t in zip(samples.tolist(), frames.tolist(), strict=True))
            sketched = window.sketched and part_of(window.sketched, samples, frames)
            lifted = self.lift(window.images[samples, frames], rigs, sketched).volume
        counts = there.sum(0).tolist()
        parts = zip(lifted.split(counts), samples.split(counts), strict=True)
        # slices and `zeros_like` keep channels last in memory
        return [
            part if len(part) == len(like) else torch.zeros_like(like).index_copy(0, sample, part)
            for part, sample in parts
        ]


def check_volume(volume: Tensor, part: object, channels: int, geometry: Grid) -> None:
    """Raise UserError, naming the part of the model, unless its output has these channels and the grid's cells."""
    if volume.shape[1:] != (channels, *geometry.shape):
        name = f"{type(part).__module__}.{type(part).__name__}"
        raise UserError(
            f"{name} returned features of shape {tuple(volume.shape)}; the model needs "
            f"(samples, {channels}, {', '.join(map(str, geometry.shape))}): channels, and the cells of the grid"
        )
