"""No hints: the paper's model."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.model.protocols import Known, Sketched


class NoHints(nn.Module):
    """Hand nothing on."""

    EVIDENCE: ClassVar[tuple[str, ...]] = ()
    pixel_classes = False

    def __init__(self):  # of its own: nn.Module's would accept anything
        super().__init__()

    def forward(
        self, sketched: Sketched, rigs: tuple[Rig, ...], pixel_logits: Float[Tensor, "B N K h w"] | None
    ) -> Known:
        """Return that nothing is known."""
        return Known()

    def in_volume(self, volume: Float[Tensor, "B C X Y Z"], known: Known) -> Float[Tensor, "B C X Y Z"]:
        """Return the same volume."""
        return volume

    def in_logits(self, known: Known) -> tuple[None, None]:
        """Return nothing to start from."""
        return None, None
