"""Weights from the Hugging Face hub, if available."""

import logging
import os
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable
from typing import TypeVar

from torch import nn
from transformers import PretrainedConfig, ResNetConfig, ResNetModel

log = logging.getLogger(__name__)

PROBE_TIMEOUT_S = 3.0
COMPARED = ("layer_type", "embedding_size", "hidden_sizes", "depths")


Network = TypeVar("Network", bound=nn.Module)


def load_or_random(weights: str | None, load: Callable[[str, bool], Network], random: Callable[[], Network]) -> Network:
    """Return the network with the named weights; if they are not available, warn once and use random ones.

    Args:
        weights: name on the hub or a folder; None for random weights without network access.
        load: builds it from this name, and whether to use local files only.
        random: builds it with random weights.
    """
    if weights is None:
        return random()
    try:
        return load(weights, not _hub_reachable(weights))
    except OSError as error:
        reason = str(error).strip().splitlines()[0]
        log.warning("no pretrained weights '%s', training from random ones: %s", weights, reason)
        return random()


def require_equal(found: PretrainedConfig, expected: PretrainedConfig, names: Iterable[str], weights: str) -> None:
    """Compare entries of two configurations; raise ValueError if the weights belong to a network of other sizes."""
    for name in names:
        ours, theirs = getattr(expected, name), getattr(found, name)
        if ours != theirs:
            raise ValueError(f"weights '{weights}' have {name} {theirs}, the config asks for {ours}; make them agree")


def build_resnet(config: ResNetConfig, weights: str | None) -> ResNetModel:
    """Return a ResNet with the named weights, or with random ones (see `load_or_random`).

    Raises:
        ValueError: if the weights belong to a network of other sizes.
    """

    def load(name: str, local: bool) -> ResNetModel:
        model = ResNetModel.from_pretrained(name, local_files_only=local)
        require_equal(model.config, config, COMPARED, name)
        return model

    return load_or_random(weights, load, lambda: ResNetModel(config))


def _hub_reachable(weights: str) -> bool:
    """Return whether the hub can be reached, since transformers would retry for minutes without a network."""
    if os.path.isdir(weights) or os.environ.get("HF_HUB_OFFLINE", "0").upper() in ("1", "TRUE", "YES", "ON"):
        return False
    endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co")
    try:
        with urllib.request.urlopen(urllib.request.Request(endpoint, method="HEAD"), timeout=PROBE_TIMEOUT_S):
            return True
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False
