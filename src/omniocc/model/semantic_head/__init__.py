"""Semantic head slot: classes of pixels, to supervise the backbone directly."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from omniocc.model.semantic_head.fcn import FCN
from omniocc.model.semantic_head.none import NoSemanticHead

__all__ = ["FCN", "NoSemanticHead", "SemanticHead"]


@runtime_checkable
class SemanticHead(Protocol):
    """Classifies the pixels of a feature map."""

    def __call__(self, features: list[Float[Tensor, "B N C _ _"]]) -> Float[Tensor, "B N K h w"] | None:
        """Feature maps, finest first -> logits at the finest map's size, or None."""
        ...
