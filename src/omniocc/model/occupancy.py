"""The chain: images -> backbone -> lifter -> temporal -> refiner -> class of every voxel."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.backbone import Backbone
from omniocc.model.lifter import GuessesRanges, Lifter
from omniocc.model.ops.padding import Pointwise
from omniocc.model.refiner import Refiner
from omniocc.model.semantic_head import SemanticHead
from omniocc.model.sketch import Sketch
from omniocc.model.temporal import Temporal


class Prediction(NamedTuple):
    """What a model says about the newest frame of each window.

    Attributes:
        logits: of the class of every voxel.
        pixel_logits: of the class of every pixel, at the finest feature map's size; None without a semantic head.
        range_logits: of bins of range along the rays, at the coarsest map's size; None if not asked for, or if the
            lifter guesses none.
    """

    logits: Float[Tensor, "B C X Y Z"]
    pixel_logits: Float[Tensor, "B N C h w"] | None
    range_logits: Float[Tensor, "B N D h w"] | None


class Lifted(NamedTuple):
    """What single frames give.

    Attributes:
        volume: features of every voxel, in each frame's own ego frame.
        features: of the images, finest first.
    """

    volume: Float[Tensor, "B C X Y Z"]
    features: list[Float[Tensor, "B N C _ _"]]


class OccupancyModel(nn.Module):
    """Camera images to semantic occupancy, in exchangeable parts (paper, figure 'Overall architecture').

    Args:
        backbone: images to feature maps.
        geometry: the voxel grid.
        sketch: chooses candidate voxels.
        lifter: feature maps to voxel features.
        temporal: fuses a window of volumes.
        refiner: voxel features to voxel features.
        semantic_head: feature maps to classes of pixels.
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
        num_classes: int,
    ):
        super().__init__()
        self.geometry = geometry
        self.backbone = backbone
        self.sketch = sketch.requires_grad_(False) if isinstance(sketch, nn.Module) else sketch
        self.lifter = lifter
        self.temporal = temporal
        self.refiner = refiner
        self.semantic_head = semantic_head
        self.classifier = Pointwise(refiner.channels, num_classes)

    def forward(
        self,
        images: UInt8[Tensor, "B T N 3 H W"] | Float[Tensor, "B T N 3 H W"],
        rigs: tuple[Rig, ...],
        world_from_ego: Float[Tensor, "B T 4 4"],
        candidates: Bool[Tensor, "B T X Y Z"] | None = None,
        exists: Bool[Tensor, "B T"] | None = None,
        with_ranges: bool = False,
    ) -> Prediction:
        """Logits for the newest frame.

        Args:
            images: RGB 0..255 as uint8, or [0, 1] as floats; frames oldest first.
            rigs: cameras of each sample.
            world_from_ego: pose of each frame.
            candidates: what the sketch says about these frames, where it has been asked before.
            exists: which frames were recorded; the others, before a scene's first, cost nothing. None: all.
            with_ranges: whether a loss looks at what the lifter guesses of ranges.
        """
        if exists is None:
            exists = torch.ones(images.shape[:2], dtype=torch.bool, device=images.device)
        window = slice(-self.temporal.frames, None)
        images, world_from_ego, exists = images[:, window], world_from_ego[:, window], exists[:, window]
        candidates = None if candidates is None else candidates[:, window]
        # the newest first: autocast keeps what it casts, in older PyTorch without gradient if the past came first
        newest = self.lift(images[:, -1], rigs, None if candidates is None else candidates[:, -1])
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.temporal.history_gradient):
            past = self._lift_past(images, rigs, candidates, exists, newest.volume)
        volume = self.fuse([*past, newest.volume], world_from_ego, exists)
        ranges = None
        if with_ranges and isinstance(self.lifter, GuessesRanges):
            ranges = self.lifter.range_logits(newest.features)
        return Prediction(volume, self.semantic_head(newest.features), ranges)

    def lift(
        self,
        images: UInt8[Tensor, "B N 3 H W"] | Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        candidates: Bool[Tensor, "B X Y Z"] | None = None,
    ) -> Lifted:
        """What single frames give: features of the images, and of the voxels in each frame's own ego frame."""
        images = to_unit_range(images)
        chosen = self.choose(images, rigs) if candidates is None else candidates
        features = self.backbone(images)
        return Lifted(self.lifter(features, chosen, rigs), features)

    @torch.no_grad()
    def choose(self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...]) -> Bool[Tensor, "B X Y Z"]:
        """Candidates of single frames; the sketch has learned in a stage of its own."""
        return self.sketch(images, rigs)

    def fuse(
        self,
        volumes: list[Float[Tensor, "B C X Y Z"]],
        world_from_ego: Float[Tensor, "B T 4 4"],
        exists: Bool[Tensor, "B T"],
    ) -> Float[Tensor, "B classes X Y Z"]:
        """Logits of the newest frame from the lifted volumes of a window, oldest first."""
        return self.classifier(self.refiner(self.temporal(volumes, world_from_ego, exists)))

    def _lift_past(
        self,
        images: UInt8[Tensor, "B T N 3 H W"] | Float[Tensor, "B T N 3 H W"],
        rigs: tuple[Rig, ...],
        candidates: Bool[Tensor, "B T X Y Z"] | None,
        exists: Bool[Tensor, "B T"],
        like: Float[Tensor, "B C X Y Z"],
    ) -> list[Float[Tensor, "B C X Y Z"]]:
        """All past frames that exist in one go; zeros, laid out as `like`, for the others."""
        if exists.shape[1] == 1:
            return []
        frames, samples = exists[:, :-1].T.nonzero(as_tuple=True)
        lifted = like[:0]
        if len(frames):
            chosen = None if candidates is None else candidates[samples, frames]
            lifted = self.lift(images[samples, frames], tuple(rigs[i] for i in samples.tolist()), chosen).volume
        counts = exists[:, :-1].sum(0).tolist()
        parts = zip(lifted.split(counts), samples.split(counts), strict=True)
        # slices and `zeros_like` keep channels last in memory
        return [
            part if len(part) == len(like) else torch.zeros_like(like).index_copy(0, sample, part)
            for part, sample in parts
        ]


def to_unit_range(images: UInt8[Tensor, "..."] | Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """RGB in [0, 1]; floats are taken to be there already."""
    return images if images.is_floating_point() else images.float() / 255
