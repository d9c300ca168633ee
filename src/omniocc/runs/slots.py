"""Read a configuration: the option in each slot of a model, which slots learn, and which packages it names."""

from collections.abc import Mapping, Sequence
from typing import Any

from omniocc.code import code_of_classes, module_of
from omniocc.config import OWN_PACKAGE, PACKAGES, target_of
from omniocc.model.protocols import learns


def sketch_learns(config: Mapping[Any, Any]) -> bool:
    """Return whether the sketch is trained: in its own stage before occupancy, on ranges of the depth option."""
    return learns(target_of(config["model"]["sketch"]))


def depth_learns(config: Mapping[Any, Any]) -> bool:
    """Return whether the depth option is trained."""
    return learns(target_of(config["depth"]))


def uses_evidence(config: Mapping[Any, Any]) -> bool:
    """Return whether any hint of the model is on; hints are made from the sketch's evidence, which is then stored."""
    hints = config["model"]["hints"]
    return any(hints[part] for part in ("queries", "volume", "logits"))


def option_of(node: Mapping[Any, Any]) -> str:
    """Return the option that a node of a configuration chooses, by its name in `conf/`.

    It is the name of the module that holds the class. In other packages modules may have any names, so there it is the
    name of the class.
    """
    name = str(node["_target_"])
    module, _, own_name = name.rpartition(".")
    return module_of(name).rpartition(".")[2] if module.partition(".")[0] in OWN_PACKAGE else own_name


def slots_of(config: Mapping[str, Any]) -> dict[str, str]:
    """Return the option in every slot, such as `sketch: omni`; the slot `depth` is included if the sketch learns."""
    nodes = {slot: node for slot, node in config["model"].items() if isinstance(node, Mapping) and "_target_" in node}
    if sketch_learns(config):
        nodes["depth"] = config["depth"]
    found = {slot: option_of(node) for slot, node in nodes.items()}
    if "hints" in nodes and not any(value for key, value in nodes["hints"].items() if key != "_target_"):
        found["hints"] = "none"  # the same class with all switches off
    return found


def slots_line(config: Mapping[str, Any]) -> str:
    """Return a line with all options and the grid's shape: `geometry=cylinder, sketch=omni; 64x100x8 voxels`."""
    options = ", ".join(f"{slot}={option}" for slot, option in slots_of(config).items())
    return f"{options}; {'x'.join(map(str, config['model']['geometry']['shape']))} voxels"


def foreign_packages(tree: Any, packages: Sequence[str]) -> list[str]:
    """Return the packages, sorted, whose classes a plain tree names, without those in `packages`."""
    return sorted({name.split(".")[0] for name in targets_in(tree)} - set(packages))


def foreign_code(tree: Any) -> list[str]:
    """Return one hash (`omniocc.code.code_of_classes`) of the code of a plain tree's classes beyond `PACKAGES`.

    It is the only item of a list, which is empty without such classes, so that hashes without them stay the same.
    """
    code = code_of_classes(name for name in targets_in(tree) if name.split(".")[0] not in PACKAGES)
    return [code] if code else []


def targets_in(tree: Any) -> set[str]:
    """Return the full names of the classes (`_target_`) in a plain tree."""
    children = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    found = {name for child in children for name in targets_in(child)}
    return found | ({str(tree["_target_"])} if isinstance(tree, dict) and "_target_" in tree else set())
