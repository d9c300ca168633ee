"""Which option fills which slot of a model, in words to group runs by."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any


def option_of(target: str) -> str:
    """The option's name: that of the file its class is in, as in `conf/`.

    Args:
        target: import path of a class, as in `_target_`.
    """
    package, _, name = target.rpartition(".")
    return getattr(import_module(package), name).__module__.rpartition(".")[2]


def slots_of(config: Mapping[str, Any]) -> dict[str, str]:
    """Option by slot, for example `sketch: omni`; `depth` where the sketch asks for it.

    Args:
        config: a run's resolved configuration.
    """
    model = config["model"]
    nodes = {slot: node for slot, node in model.items() if isinstance(node, Mapping) and "_target_" in node}
    if "depth" in nodes.get("sketch", {}):
        nodes["depth"] = model["sketch"]["depth"]
    return {slot: option_of(node["_target_"]) for slot, node in nodes.items()}
