"""Backbone slot: image features."""

from omniocc.model.backbone.efficientnet_lite0 import EfficientNetLite0
from omniocc.model.backbone.resnet import ResNet
from omniocc.model.backbone.transformers import Transformers
from omniocc.model.protocols import Backbone

__all__ = ["Backbone", "EfficientNetLite0", "ResNet", "Transformers"]
