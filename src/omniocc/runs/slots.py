"""The option in each slot of a model, and whether there are stages before occupancy."""

from collections.abc import Mapping
from typing import Any

from omniocc.config import OWN_PACKAGE, target_of
from omniocc.model.protocols import learns


def sketch_learns(config: Mapping[Any, Any]) -> bool:
    """Return whether the sketch is trained, on ranges of the depth slot, in stages before occupancy."""
    return learns(target_of(config["model"]["sketch"]))


def depth_learns(config: Mapping[Any, Any]) -> bool:
    """Return whether the depth option is trained."""
    return learns(target_of(config["depth"]))


def uses_evidence(config: Mapping[Any, Any]) -> bool:
    """Return whether the hints hand the sketch's evidence on, which its stage then stores."""
    hints = config["model"]["hints"]
    return any(hints[part] for part in ("queries", "volume", "logits"))


def option_of(node: Mapping[Any, Any]) -> str:
    """Return the option of a node: the name of the file that its class is in, as in `conf/`.

    Of a class of another package, whose files may have any names, it is the name of the class.
    """
    target = target_of(node)
    return (
        target.__module__.rpartition(".")[2] if target.__module__.partition(".")[0] in OWN_PACKAGE else target.__name__
    )


def slots_of(config: Mapping[str, Any]) -> dict[str, str]:
    """Return the option in every slot, for example `sketch: omni`; `depth` if the sketch learns."""
    nodes = {slot: node for slot, node in config["model"].items() if isinstance(node, Mapping) and "_target_" in node}
    if sketch_learns(config):
        nodes["depth"] = config["depth"]
    return {slot: option_of(node) for slot, node in nodes.items()}


def slots_line(config: Mapping[str, Any]) -> str:
    """Return the options of all slots and the voxels: `geometry=cylinder, sketch=omni; 64x100x8 voxels`."""
    slots = ", ".join(f"{slot}={option}" for slot, option in slots_of(config).items())
    return f"{slots}; {'x'.join(map(str, config['model']['geometry']['shape']))} voxels"
