"""Refiner slot: reasoning on the whole grid."""

from omniocc.model.protocols import Refiner
from omniocc.model.refiner.attention import Attention
from omniocc.model.refiner.conv import Conv
from omniocc.model.refiner.none import NoRefiner
from omniocc.model.refiner.unet import UNet

__all__ = ["Attention", "Conv", "NoRefiner", "Refiner", "UNet"]
