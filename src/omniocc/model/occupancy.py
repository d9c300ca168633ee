"""The chain: images -> backbone -> lifter -> temporal -> refiner -> class of every voxel."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.backbone import Backbone
from omniocc.model.lifter import Lifter
from omniocc.model.padding import Pointwise
from omniocc.model.refiner import Refiner
from omniocc.model.semantic_head import SemanticHead
from omniocc.model.sketch import Sketch
from omniocc.model.temporal import Temporal


class Prediction(NamedTuple):
    """What a model says about the newest frame of each window.

    Attributes:
        logits: of the class of every voxel.
        pixel_logits: of the class of every pixel, at the finest feature map's size; None without a semantic head.
    """

    logits: Float[Tensor, "B C X Y Z"]
    pixel_logits: Float[Tensor, "B N C h w"] | None


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
    ) -> Prediction:
        """Logits for the newest frame.

        Args:
            images: RGB 0..255 as uint8, or [0, 1] as floats; frames oldest first.
            rigs: cameras of each sample.
            world_from_ego: pose of each frame.
            candidates: what the sketch says about these frames, where it has been asked before.
        """
        window = to_unit_range(images[:, -self.temporal.frames :])
        *past, newest = window.unbind(1)
        if candidates is None:
            candidates = self.choose(window, rigs)
        *past_voxels, voxels = candidates[:, -self.temporal.frames :].unbind(1)
        with torch.no_grad():
            volumes = [self.lifter(self.backbone(f), v, rigs) for f, v in zip(past, past_voxels, strict=True)]
        features = self.backbone(newest)
        volumes.append(self.lifter(features, voxels, rigs))
        volume = self.temporal(volumes, world_from_ego[:, -len(volumes) :])
        volume = self.refiner(volume)
        return Prediction(self.classifier(volume), self.semantic_head(features))

    @torch.no_grad()
    def choose(self, images: Float[Tensor, "B T N 3 H W"], rigs: tuple[Rig, ...]) -> Bool[Tensor, "B T X Y Z"]:
        """Candidates of every frame; the sketch has learned in a stage of its own."""
        return torch.stack([self.sketch(frame, rigs) for frame in images.unbind(1)], dim=1)


def to_unit_range(images: UInt8[Tensor, "..."] | Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """RGB in [0, 1]; floats are taken to be there already."""
    return images if images.is_floating_point() else images.float() / 255
