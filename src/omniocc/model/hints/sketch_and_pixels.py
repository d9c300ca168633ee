"""Evidence of the sketch and classes of the 2D head, in the queries, in the volume and in the first logits."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Size
from omniocc.camera import Rig
from omniocc.classes import FREE
from omniocc.geometry import Grid
from omniocc.model.ops.evidence import INPUTS, LOG_ODDS, network_inputs
from omniocc.model.ops.padding import Pointwise
from omniocc.model.ops.voxel_samples import sample_at_voxels
from omniocc.model.protocols import Sketched


class Known(NamedTuple):
    """What is known of the voxels of single frames; None where it is not used.

    Attributes:
        evidence: of the sketch, of every voxel.
        classes: logits of the 2D head at the candidates, 0 elsewhere.
    """

    evidence: Float[Tensor, "B 4 X Y Z"] | None
    classes: Float[Tensor, "B K X Y Z"] | None


class SketchAndPixels(nn.Module):
    """Hand on the sketch's evidence of every voxel, and the 2D head's classes at the candidates.

    With all switches off nothing is handed on, as in the paper.

    Args:
        stride: of the finest feature map, where the 2D head classifies, px.
        channels: of the volume.
        num_classes: of voxels and pixels; 0 is free or sky.
        queries: whether the lifter's queries also start from the evidence; the lifter's config reads this key as
            `evidence`.
        volume: whether the evidence is added to the volume before the refiner.
        logits: whether the logits start from the sketch's probabilities of being occupied.
        pixel_classes: whether the 2D head's classes at the candidates are added to the volume, and the logits start
            from them.
    """

    def __init__(
        self,
        geometry: Grid,
        stride: int,
        channels: Size,
        num_classes: Size,
        queries: bool = False,
        volume: bool = False,
        logits: bool = False,
        pixel_classes: bool = False,
    ):
        super().__init__()
        self.geometry, self.stride = geometry, stride
        self.queries, self.logits = queries, logits
        self.evidence = Pointwise(INPUTS, channels) if volume else None
        self.classes = Pointwise(num_classes, channels) if pixel_classes else None
        self.class_weight = nn.Parameter(torch.ones(num_classes - 1)) if pixel_classes else None

    def forward(
        self, sketched: Sketched, rigs: tuple[Rig, ...], pixel_logits: Float[Tensor, "B N K h w"] | None
    ) -> Known:
        """Return what is known of the voxels of single frames.

        Raises:
            ValueError: if evidence is used and the sketch has none, or there are no logits of pixels.
        """
        evidence = sketched.evidence() if self.logits or self.evidence is not None else None
        if self.classes is None:
            return Known(evidence, None)
        if pixel_logits is None:
            raise ValueError("pixel_classes needs a 2D head: choose model/semantic_head=fcn")
        # zero logits, where no camera sees a candidate, prefer no class
        return Known(evidence, sample_at_voxels(pixel_logits, sketched.candidates, rigs, self.geometry, self.stride))

    def in_volume(self, volume: Float[Tensor, "B C X Y Z"], known: Known) -> Float[Tensor, "B C X Y Z"]:
        """Return the volume, to which the hints are added."""
        if self.evidence is not None and known.evidence is not None:
            volume = volume + self.evidence(network_inputs(known.evidence))
        if self.classes is not None and known.classes is not None:
            volume = volume + self.classes(known.classes.softmax(1))
        return volume

    def in_logits(self, known: Known) -> tuple[Float[Tensor, "B X Y Z"] | None, Float[Tensor, "B X Y Z O"] | None]:
        """Return log-odds of being occupied and scores of the occupied classes, from which the logits start.

        How much the 2D head counts is learned for each class.
        """
        log_odds = known.evidence[:, LOG_ODDS] if self.logits and known.evidence is not None else None
        if self.class_weight is None or known.classes is None:
            return log_odds, None
        seen = known.classes.movedim(1, -1)[..., FREE + 1 :].float()
        return log_odds, self.class_weight * seen.log_softmax(-1)
