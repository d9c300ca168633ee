"""Say what a configuration in a file may hold: plain values, and classes that `conf` offers for their place."""

import itertools
import resource
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from re import fullmatch
from typing import Any, NamedTuple
from unicodedata import category

from torch import Tensor
from torch.nn.modules.module import register_module_parameter_registration_hook

import omniocc
from omniocc.config import CONF, ConfigError
from omniocc.errors import UserError, first_line
from omniocc.io import read_yaml

GROUPS = {
    "depth": "model/depth",
    "model": "model",
    "loss": "loss",
    "optimizer": "optimizer",
    "augment": "augment",
    "data": "data",
}
"""Root keys of what is built from a file, and their folders in `conf`; of two that hold a file the first counts."""
GLOBAL = "# @package _global_"
"""First line of files that begin at the root of a configuration, such as models and rows."""
TARGET = "_target_"
SPARE_PARAMETERS = 1000
"""Parameters that a model may have besides some multiples of its weights, while it is built."""
SPARE_BYTES = 2**30
"""Memory that building a model may take besides some multiples of its weights."""
MAX_DEPTH, MAX_VALUES, MAX_LETTERS = 30, 20_000, 4_096
"""Limits of a configuration in a file: levels, values, letters of one text; `model=extended` has 6, 330 and 104."""


class Offered(NamedTuple):
    """The classes that `conf` offers.

    Attributes:
        classes: their names by place (`model.sketch`); the last part is `*` where a mapping may have any keys.
        same: places whose value is that of another place (`data.geometry` is `model.geometry`).
    """

    classes: dict[str, set[str]]
    same: dict[str, str]

    def place(self, parent: str, key: str, named: bool) -> str:
        """Return the place of a key of a node at the place `parent`; `named` says whether the node has a class."""
        own = f"{parent}.{key}" if named or f"{parent}.*" not in self.classes else f"{parent}.*"
        return own if own in self.classes else self.same.get(own, own)


@cache
def offered(conf: Path = CONF) -> Offered:
    """Return the classes that the options in a folder offer.

    Raises:
        UserError: when there is no such folder, as where the package was installed without it.
    """
    if not conf.is_dir():
        raise UserError(
            f"{conf} is missing, which says what a file of weights may name: install the package again, or "
            "use a clone of the repository, installed by 'make setup'"
        )
    found = Offered(defaultdict(set), {})
    for path in sorted(conf.rglob("*.yaml")):
        if path.read_text("utf-8").startswith(GLOBAL):
            for root, node in (read_yaml(path) or {}).items():
                _collect(node, root, found)
        elif root := next((root for root, folder in GROUPS.items() if path.is_relative_to(conf / folder)), None):
            slot = path.parent.relative_to(conf / GROUPS[root]).parts
            _collect(read_yaml(path), ".".join((root, *slot)), found)
    return found


def _collect(node: Any, place: str, found: Offered) -> None:
    if isinstance(node, str) and (reference := fullmatch(r"\$\{([\w.]+)\}", node)):
        found.same[place] = reference[1]
    if not isinstance(node, Mapping):
        return
    if TARGET in node:
        found.classes[place].add(node[TARGET])
    for key, value in node.items():
        named = TARGET in node or not isinstance(value, Mapping) or TARGET not in value
        _collect(value, f"{place}.{key}" if named else f"{place}.*", found)


def fault_of(config: object) -> str | None:
    """Return why a configuration from a file is refused; None if it is plain values without interpolations.

    An interpolation would read this machine (`${oc.env:HOME}`), and one with a backslash before it becomes one when it
    is resolved. Hydra's own keys (`_args_`, `_partial_` ...) would change how an option is built.
    """
    if not isinstance(config, Mapping) or not config:
        return "its configuration is no mapping, or empty"
    left: list[tuple[str, int, object]] = [("", 0, config)]
    seen = 0
    while left:
        place, depth, node = left.pop()
        seen += 1
        if seen > MAX_VALUES or depth > MAX_DEPTH:
            return f"its configuration has more than {MAX_VALUES} values or {MAX_DEPTH} levels"
        if isinstance(node, Mapping):
            for key, value in node.items():
                if not isinstance(key, str | int) or _fault_of_text(str(key)):
                    return f"a key of its configuration below '{place.rstrip('.')}' is no plain name"
                own = str(key).startswith("_") and str(key).endswith("_")
                if own and not (key == TARGET and isinstance(value, str)):
                    return f"its configuration has the key {place}{key}, which only Hydra may read, or no name there"
                left.append((f"{place}{key}.", depth + 1, value))
        elif isinstance(node, list | tuple):
            left += [(f"{place}{number}.", depth + 1, value) for number, value in enumerate(node)]
        elif isinstance(node, str):
            if (fault := _fault_of_text(node)) is not None:
                return f"its configuration at {place.rstrip('.')} {fault}"
        elif not isinstance(node, int | float | None):
            return f"its configuration at {place.rstrip('.')} is no plain value"
    return None


def _fault_of_text(text: str) -> str | None:
    if "${" in text:
        return "has an interpolation (${...}), which a file may not have"
    if any(category(letter) in ("Cc", "Cs") for letter in text[:MAX_LETTERS] if letter not in "\n\t"):
        return "has letters that cannot be printed"
    return f"has more than {MAX_LETTERS} letters" if len(text) > MAX_LETTERS else None


def not_offered(tree: Mapping[str, Any], packages: Sequence[str]) -> Iterator[str]:
    """Yield a line for every class in a plain tree that `conf` does not offer at its place.

    Classes of `packages` other than this one may be anywhere, and may have every option of a model inside of them.
    """
    known = offered()
    own = omniocc.__name__
    anything = {name for place, names in known.classes.items() if not place.startswith("data") for name in names}

    def walk(node: Any, place: str, path: str, inside_foreign: bool) -> Iterator[str]:
        if isinstance(node, list):
            for number, value in enumerate(node):
                yield from walk(value, f"{place}.{number}", f"{path}.{number}", inside_foreign)
        if not isinstance(node, Mapping):
            return
        if TARGET in node:
            name = node[TARGET]
            package = str(name).partition(".")[0]
            options = anything if inside_foreign else known.classes.get(place, set())
            if package != own and package in packages:
                inside_foreign = True
            elif name not in options:
                names = ", ".join(sorted(options)) or "no class"
                yield f"{path} names {name!r}, and conf offers {names} there"
        for key, value in node.items():
            yield from walk(value, known.place(place, str(key), TARGET in node), f"{path}.{key}", inside_foreign)

    for root, node in tree.items():
        yield from walk(node, root, root, False)


@contextmanager
def building(path: Path, weights: Mapping[str, Tensor]) -> Iterator[None]:
    """Turn everything that goes wrong while a model is built from a file into one line that names the file.

    Its sizes may have any values, so what is built may have no more parameters, and take no more memory, than some
    multiples of its weights.

    Raises:
        UserError: when something goes wrong.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text("utf-8").split()[0]) * resource.getpagesize()
    stored = {data.data_ptr(): data.nbytes() for data in (value.untyped_storage() for value in weights.values())}
    most = used + SPARE_BYTES + 16 * sum(stored.values())
    resource.setrlimit(resource.RLIMIT_AS, (most if soft == resource.RLIM_INFINITY else min(most, soft), hard))
    registered = itertools.count(1)

    def count(*_: object) -> None:
        if next(registered) > SPARE_PARAMETERS + 8 * len(weights):
            raise MemoryError("more parameters than the file has weights")

    hook = register_module_parameter_registration_hook(count)
    try:
        yield
    except ConfigError as error:
        raise ConfigError(error.problems, path) from error
    except (UserError, OSError):
        raise
    except Exception as error:
        if isinstance(error, MemoryError) or "allocate memory" in str(error):
            raise UserError(f"{path} names sizes of a model that need far more than its weights") from error
        reason = f"{type(error).__name__}: {first_line(error)}; is it of another version?"
        raise UserError(f"{path} describes a model that cannot be built: {reason}") from error
    finally:
        hook.remove()
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
