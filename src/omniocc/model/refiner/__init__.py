"""Refiner slot: reasoning on the whole grid."""

from omniocc.model.protocols import Refiner
from omniocc.model.refiner.attention import Attention
from omniocc.model.refiner.channel_to_height import ChannelToHeight
from omniocc.model.refiner.conv import Conv
from omniocc.model.refiner.experts import Experts
from omniocc.model.refiner.focus import Focus
from omniocc.model.refiner.none import NoRefiner
from omniocc.model.refiner.unet import UNet

__all__ = ["Attention", "ChannelToHeight", "Conv", "Experts", "Focus", "NoRefiner", "Refiner", "UNet"]
