"""Backbone slot: image features."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from omniocc.model.backbone.efficientnet_lite0 import EfficientNetLite0
from omniocc.model.protocols import Backbone

if TYPE_CHECKING:
    from omniocc.model.backbone.resnet import ResNet
    from omniocc.model.backbone.transformers import Transformers

__all__ = ["Backbone", "EfficientNetLite0", "ResNet", "Transformers"]


def __getattr__(name: str) -> Any:
    """Import a backbone of the package transformers at its first use: that takes a second."""
    if name in ("ResNet", "Transformers"):
        return getattr(import_module(f"omniocc.model.backbone.{name.lower()}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
