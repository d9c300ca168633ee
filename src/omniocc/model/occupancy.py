"""The chain: images -> backbone -> lifter -> temporal -> refiner -> classifier -> class of every voxel."""

from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.camera.pinholes import as_pinholes
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model.ops.classifier import Classifier
from omniocc.model.ops.evidence import INPUTS, network_inputs, required
from omniocc.model.ops.padded import FeatureMaps, by_shape
from omniocc.model.ops.padding import Pointwise
from omniocc.model.ops.rig_cache import once_per_rig
from omniocc.model.ops.voxel_samples import sample_at_voxels
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
    volume_and_extras,
)


def as_they_are(rig: Rig) -> Rig:
    """Return the rig itself."""
    return rig


LENSES = {"own": as_they_are, "pinhole": once_per_rig(as_pinholes)}
"""What the lifter takes the cameras for."""


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


class OccupancyModel(nn.Module):
    """Predict semantic occupancy from camera images, in exchangeable parts (paper, figure 'Overall architecture').

    Samples may have different numbers of cameras and sizes of image, padded as in `omniocc.model.ops.padded`.

    Beyond the paper, what the sketch and the 2D head know of a voxel can be handed on to the later slots.

    Args:
        num_classes: of voxels, free included.
        evidence_in_volume: whether the sketch's evidence is added to the volume before the refiner.
        evidence_in_logits: whether the logits start from the sketch's probabilities.
        pixel_classes: whether the 2D head's classes at the voxels are added to the volume, and the logits start from
            them.
        lens: what the lifter takes the cameras for: `own`, what they are, or `pinhole`, which is wrong for others; to
            measure what the true lens model is worth.
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
        num_classes: int,
        evidence_in_volume: bool = False,
        evidence_in_logits: bool = False,
        pixel_classes: bool = False,
        lens: Literal["own", "pinhole"] = "own",
    ):
        super().__init__()
        self.geometry = geometry
        self.lens = lens
        self.backbone = backbone
        self.sketch = sketch.requires_grad_(False) if isinstance(sketch, nn.Module) else sketch
        self.lifter = lifter
        self.temporal = temporal
        self.refiner = refiner
        self.semantic_head = semantic_head
        self.evidence = Pointwise(INPUTS, lifter.channels) if evidence_in_volume else None
        self.seen_classes = Pointwise(num_classes, lifter.channels) if pixel_classes else None
        self.classifier = Classifier(geometry, refiner.channels, num_classes, evidence_in_logits, pixel_classes)

    def forward(
        self,
        images: UInt8[Tensor, "B T N 3 H W"] | Float[Tensor, "B T N 3 H W"],
        rigs: tuple[tuple[Rig, ...], ...],
        world_from_ego: Float[Tensor, "B T 4 4"],
        sketched: Sketched | None = None,
        exists: Bool[Tensor, "B T"] | None = None,
        with_ranges: bool = False,
    ) -> Prediction:
        """Return logits for the newest frame.

        Args:
            images: RGB 0..255 as uint8, or [0, 1] as floats; frames oldest first.
            rigs: of each sample one per frame; cameras may move on the vehicle.
            world_from_ego: pose of each frame.
            sketched: output of the sketch for every frame, with an axis T; None runs the sketch.
            exists: which frames were recorded; the others, before a scene's first, are not computed. None: all.
            with_ranges: whether to return the lifter's scores of range bins.

        Raises:
            ValueError: if rigs and images do not fit together.
        """
        given, (batch, frames) = [len(sample) for sample in rigs], images.shape[:2]
        if given != [frames] * batch:
            raise ValueError(f"rigs of {given} frames for {batch} samples of {frames} frames; give one for each frame")
        if exists is None:
            exists = torch.ones(images.shape[:2], dtype=torch.bool, device=images.device)
        window = slice(-self.temporal.frames, None)
        images, world_from_ego, exists = images[:, window], world_from_ego[:, window], exists[:, window]
        rigs = tuple(sample[window] for sample in rigs)
        sketched = sketched and sketched.at(slice(None), window)
        # the newest first: older versions of PyTorch cache weights for autocast as their first use needs them, and the
        # past may need no gradient
        newest = self.lift(
            images[:, -1], tuple(sample[-1] for sample in rigs), sketched and sketched.at(slice(None), -1)
        )
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.temporal.history_gradient):
            past = self._lift_past(images, rigs, sketched, exists, newest.volume)
        pixel_logits = self.semantic_head(newest.features)
        seen = self.with_classes(newest, tuple(sample[-1] for sample in rigs), pixel_logits)
        logits, extras = self._fuse([*past, newest.volume], world_from_ego, exists, seen)
        ranges = None
        if with_ranges and isinstance(self.lifter, GuessesRanges):
            ranges = self.lifter.range_logits(newest.features)
        coarse_logits = newest.extras.coarse_logits + extras.coarse_logits
        return Prediction(logits, pixel_logits, ranges, coarse_logits, extras.run_lengths)

    def lift(
        self,
        images: UInt8[Tensor, "B N 3 H W"] | Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        sketched: Sketched | None = None,
    ) -> Lifted:
        """Return the features of images and voxels of single frames; without `sketched` the sketch is run."""
        images = to_unit_range(images)
        sketched = self.choose(images, rigs) if sketched is None else sketched
        features = by_shape(lambda cropped, _: self.backbone(cropped), images, rigs, self.backbone.levels)
        volume, extras = volume_and_extras(self.lifter, features, sketched, tuple(map(LENSES[self.lens], rigs)))
        check_volume(volume, self.lifter, self.lifter.channels, self.geometry)
        return Lifted(volume, sketched, features, extras)

    @property
    def uses_evidence(self) -> bool:
        """Return whether a part of the model uses the sketch's evidence."""
        in_queries = getattr(self.lifter, "evidence", None) is not None
        return in_queries or self.evidence is not None or self.classifier.use_evidence

    @torch.no_grad()
    def choose(self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...]) -> Sketched:
        """Return the output of the sketch for single frames, without gradient: it is trained in its own stage."""
        return self.sketch(images, rigs)

    def with_classes(
        self, lifted: Lifted, rigs: tuple[Rig, ...], pixel_logits: Float[Tensor, "B N K h w"] | None = None
    ) -> Sketched:
        """Return what is known of the voxels of single frames, with the 2D head's classes if the model uses them.

        The head is run if its logits are not given. Raises ValueError if the model has no head.
        """
        if self.seen_classes is None:
            return lifted.sketched
        pixel_logits = self.semantic_head(lifted.features) if pixel_logits is None else pixel_logits
        if pixel_logits is None:
            raise ValueError("pixel_classes needs a 2D head: choose model/semantic_head=fcn")
        candidates, stride = lifted.sketched.candidates, self.backbone.levels[0]
        # zero logits, where no camera sees a candidate, prefer no class
        classes = sample_at_voxels(pixel_logits, candidates, rigs, self.geometry, stride)
        return lifted.sketched._replace(classes=classes)

    def fuse(
        self,
        volumes: Volumes,
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
        sketched: Sketched,
    ) -> Float[Tensor, "B classes X Y Z"]:
        """Return logits of the newest frame from the lifted volumes of a window, oldest first.

        `sketched` is that of the newest frame, from `with_classes`.
        """
        return self._fuse(volumes, world_from_ego, exists, sketched)[0]

    def _fuse(
        self,
        volumes: Volumes,
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
        sketched: Sketched,
    ) -> tuple[Float[Tensor, "B classes X Y Z"], Extras]:
        volume = self.temporal(volumes, world_from_ego, exists)
        check_volume(volume, self.temporal, self.lifter.channels, self.geometry)
        if self.evidence is not None:
            volume = volume + self.evidence(network_inputs(required(sketched.evidence)))
        if self.seen_classes is not None:
            assert sketched.classes is not None
            volume = volume + self.seen_classes(sketched.classes.softmax(1))
        volume, extras = volume_and_extras(self.refiner, volume, sketched)
        check_volume(volume, self.refiner, self.refiner.channels, self.geometry)
        return self.classifier(volume, sketched), extras

    def _lift_past(
        self,
        images: UInt8[Tensor, "B T N 3 H W"] | Float[Tensor, "B T N 3 H W"],
        rigs: tuple[tuple[Rig, ...], ...],
        sketched: Sketched | None,
        exists: Bool[Tensor, "B T"],
        like: Float[Tensor, "B C X Y Z"],
    ) -> Volumes:
        """Lift all past frames that exist in one go; return zeros, laid out as `like`, for the others."""
        if exists.shape[1] == 1:
            return []
        frames, samples = exists[:, :-1].T.nonzero(as_tuple=True)
        lifted = like[:0]
        if len(frames):
            some = tuple(rigs[s][t] for s, t in zip(samples.tolist(), frames.tolist(), strict=True))
            lifted = self.lift(images[samples, frames], some, sketched and sketched.at(samples, frames)).volume
        counts = exists[:, :-1].sum(0).tolist()
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


def to_unit_range(images: UInt8[Tensor, "..."] | Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return RGB in [0, 1]; floats are returned as they are."""
    return images if images.is_floating_point() else images.float() / 255
