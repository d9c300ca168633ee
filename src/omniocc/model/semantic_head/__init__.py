"""Semantic head slot: classes of pixels, to supervise the backbone directly."""

from omniocc.model.protocols import SemanticHead
from omniocc.model.semantic_head.fcn import FCN
from omniocc.model.semantic_head.none import NoSemanticHead

__all__ = ["FCN", "NoSemanticHead", "SemanticHead"]
