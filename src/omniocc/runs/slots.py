"""The option in each slot of a model, whether there are stages before occupancy, and whose classes are named."""

from collections.abc import Mapping, Sequence
from typing import Any

from omniocc.code import code_of_classes
from omniocc.config import OWN_PACKAGE, PACKAGES, target_of
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


def foreign_packages(tree: Any, packages: Sequence[str]) -> list[str]:
    """Return, sorted, the packages of the classes in a plain tree that are not among `packages`."""
    return sorted({name.split(".")[0] for name in classes_in(tree)} - set(packages))


def own_code(tree: Any) -> list[str]:
    """Return a hash of the code of the classes in a plain tree that are of other packages; an empty list without any.

    See `omniocc.code.code_of_classes`. A list, to be added to what is hashed.
    """
    code = code_of_classes(name for name in classes_in(tree) if name.split(".")[0] not in PACKAGES)
    return [code] if code else []


def classes_in(tree: Any) -> set[str]:
    """Return the names of the classes (`_target_`) in a plain tree."""
    children = tree.values() if isinstance(tree, Mapping) else tree if isinstance(tree, list) else ()
    found = {name for child in children for name in classes_in(child)}
    return found | ({str(tree["_target_"])} if isinstance(tree, Mapping) and "_target_" in tree else set())
