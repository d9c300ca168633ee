"""Weights from the Hugging Face hub, if they can be had."""

import logging
import os
import urllib.error
import urllib.request

from transformers import ResNetConfig, ResNetModel

log = logging.getLogger(__name__)

PROBE_TIMEOUT_S = 3.0
COMPARED = ("layer_type", "embedding_size", "hidden_sizes", "depths")


def build_resnet(config: ResNetConfig, weights: str | None) -> ResNetModel:
    """A ResNet with the named weights, or with random ones after one line of warning where they cannot be reached.

    Args:
        config: sizes of the network.
        weights: name on the hub or a folder; None for random weights, without any access to the network.

    Raises:
        ValueError: if the weights belong to a network of other sizes.
    """
    if weights is None:
        return ResNetModel(config)
    try:
        model = ResNetModel.from_pretrained(weights, local_files_only=not _hub_reachable(weights))
    except OSError as error:
        reason = str(error).strip().splitlines()[0]
        log.warning("no pretrained weights '%s', training from random ones: %s", weights, reason)
        return ResNetModel(config)
    for name in COMPARED:
        found, wanted = getattr(model.config, name), getattr(config, name)
        if found != wanted:
            raise ValueError(f"weights '{weights}' have {name} {found}, the config asks for {wanted}; make them agree")
    return model


def _hub_reachable(weights: str) -> bool:
    """Whether a request makes sense: transformers itself would retry for minutes on a machine without a network."""
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
