"""Any image backbone of the transformers library."""

from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from transformers import AutoBackbone, AutoConfig, PretrainedConfig
from transformers.models.auto.modeling_auto import MODEL_FOR_BACKBONE_MAPPING, MODEL_FOR_BACKBONE_MAPPING_NAMES

from omniocc.bounds import Size
from omniocc.model.ops.backbone import FPN, Normalize, check_finest_first, load_or_random, on_padded, require_equal
from omniocc.model.ops.padded import FeatureMaps

PROBE_PX = 224  # a multiple of 14 and 32, so that strides of 4 to 32 px and patches of 14 px divide it


class Transformers(nn.Module):
    """Extract features by a backbone of transformers, chosen by name, and a feature pyramid.

    Of stages of equal stride the deepest is used. Images are padded at the right and at the bottom to a multiple of the
    coarsest stride. Parameters that no map depends on (such as a mask token) are frozen.

    Args:
        architecture: the library's name of the network, such as convnext, swin or dinov2.
        sizes: entries of the configuration that differ from the library's default.
        weights: pretrained weights on the Hugging Face hub, or None; if not available, warn and use random ones.
        channels: of the output maps.
        levels: strides of the output maps, px, finest first; each is a stride of the network.

    Raises:
        ValueError: if there is no such architecture, size or level, or the weights are of another network.
    """

    PRETRAINED: ClassVar = ()  # `weights` also brings entries of the configuration, which a checkpoint needs

    def __init__(
        self, architecture: str, sizes: dict[str, Any], weights: str | None, channels: Size, levels: list[int]
    ):
        super().__init__()
        self.channels, self.levels = channels, list(levels)
        self.encoder = build_network(make_config(architecture, sizes), list(sizes), weights)
        self.normalize = Normalize(self.encoder)
        maps = probe(self.encoder)
        deepest = {round(PROBE_PX / level.shape[-1]): index for index, level in enumerate(maps)}
        self.strides = sorted(deepest)
        if not levels or any(level not in deepest for level in levels):
            raise ValueError(f"levels are {levels}; {architecture} has the strides {self.strides}")
        check_finest_first(list(levels))
        self.stages = [deepest[stride] for stride in self.strides]
        in_channels = [maps[stage].shape[1] for stage in self.stages]
        self.fpn = FPN(in_channels, channels, [self.strides.index(level) for level in levels])
        # the pyramid adds every coarser map to the finest level
        freeze_unused(self.encoder, [maps[stage] for stage in self.stages[self.strides.index(min(levels)) :]])

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> FeatureMaps:
        """Return feature maps of RGB in [0, 1], finest first."""
        maps = on_padded(self._maps, self.normalize(images), self.strides)
        return [level.unflatten(0, images.shape[:2]) for level in self.fpn(maps)]

    def _maps(self, images: Float[Tensor, "B 3 H W"]) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the deepest map of every stride."""
        maps = self.encoder(images).feature_maps
        return [maps[stage] for stage in self.stages]


def make_config(architecture: str, sizes: dict[str, Any]) -> PretrainedConfig:
    """Return the library's configuration of an architecture, with these sizes.

    Raises:
        ValueError: if there is no such architecture or size.
    """
    if architecture not in MODEL_FOR_BACKBONE_MAPPING_NAMES:
        known = ", ".join(sorted(MODEL_FOR_BACKBONE_MAPPING_NAMES))
        raise ValueError(f"transformers has no backbone '{architecture}'; it has {known}")
    default = AutoConfig.for_model(architecture)
    unknown = [name for name in sizes if not hasattr(default, name)]
    if unknown:
        raise ValueError(f"{architecture} has no sizes {unknown}; see {type(default).__name__} of transformers")
    return request_all_stages(AutoConfig.for_model(architecture, **sizes))


def request_all_stages(config: PretrainedConfig) -> PretrainedConfig:
    """Set a configuration so that its backbone returns the maps of all stages; return it."""
    config.out_indices = list(range(len(config.stage_names)))
    return config


def build_network(config: PretrainedConfig, compared: list[str], weights: str | None) -> nn.Module:
    """Return the network with pretrained weights, or with random ones (see `load_or_random`).

    Entries of the configuration that are not in `compared` are taken from the pretrained weights.

    Raises:
        ValueError: if the weights are of another network.
    """

    def load(name: str, local: bool) -> nn.Module:
        found = AutoConfig.from_pretrained(name, local_files_only=local, trust_remote_code=False)
        require_equal(found, config, ["model_type", *compared], name)
        network = MODEL_FOR_BACKBONE_MAPPING[type(config)]
        return network.from_pretrained(name, config=request_all_stages(found), local_files_only=local)  # type: ignore

    return load_or_random(weights, load, lambda: AutoBackbone.from_config(config))


def probe(encoder: nn.Module) -> list[Tensor]:
    """Return the maps of a black image; evaluation mode keeps running statistics as they are."""
    encoder.eval()
    maps = encoder(torch.zeros(1, 3, PROBE_PX, PROBE_PX)).feature_maps
    encoder.train()
    return list(maps)


def freeze_unused(encoder: nn.Module, maps: list[Tensor]) -> None:
    """Exclude parameters that these maps do not depend on from training."""
    parameters = list(encoder.parameters())
    gradients = torch.autograd.grad(torch.stack([level.sum() for level in maps]).sum(), parameters, allow_unused=True)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.requires_grad_(gradient is not None)
