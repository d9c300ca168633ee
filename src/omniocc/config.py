"""Compose the configuration, check it, and build objects from it; the only caller of Hydra's `instantiate`."""

import contextlib
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar, cast, get_type_hints

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException, InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError, OmegaConfBaseException

from omniocc.bounds import Batches, Count, Kept, Limit, Number, NumberOrNone, Probability, Weight, described, fits
from omniocc.code import spec_of
from omniocc.errors import UserError, first_line
from omniocc.io import checked_name
from omniocc.urls import credentials_problem

Options = TypeVar("Options")
MAX_SEED = 2**32 - 1
"""The largest seed that numpy and Lightning take."""
VERSION_BASE = "1.3"
CONF = (Path(__file__).parent / "conf").resolve()
"""Folder of the options: the one beside `src`, and a copy of it in an installed package."""
OWN_PACKAGE = ("omniocc", "omniworld", "rayiou")
PACKAGES = (*OWN_PACKAGE, "lightning", "torch")
"""Packages whose classes a configuration from the command line may name."""
PACKAGES_VARIABLE = "OMNIOCC_PACKAGES"
"""Environment variable with further packages, separated by commas."""
NOT_THERE = "cannot be imported; install it, or add its parent folder to PYTHONPATH"


class ConfigError(UserError):
    """All problems of a configuration, one line each; `path` is the file that it is from, if it is from one."""

    def __init__(self, problems: Sequence[str], path: Path | None = None):
        self.problems = tuple(problems)
        noun, of = "problem" if len(problems) == 1 else "problems", "" if path is None else f" of {path}"
        super().__init__("\n  ".join([f"{len(problems)} {noun} in the configuration{of}:", *problems]))


def allowed(packages: Sequence[str], more: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the packages whose classes may be built: these, those of `OMNIOCC_PACKAGES`, and more."""
    named = os.environ.get(PACKAGES_VARIABLE, "").split(",")
    return tuple(dict.fromkeys([*packages, *(name.strip() for name in named if name.strip()), *more]))


def own_folders() -> list[Path]:
    """Return the folders `conf` of the packages in `OMNIOCC_PACKAGES`; raise UserError when one cannot be imported."""
    found = []
    for package in allowed(()):
        if (spec := spec_of(package)) is None:
            raise UserError(f"{package}, which {PACKAGES_VARIABLE} names, {NOT_THERE}")
        found += [Path(place) / "conf" for place in spec.submodule_search_locations or ()]
    return [folder for folder in found if folder.is_dir()]


def check(cfg: DictConfig, root_keys: Sequence[str] | None = None, packages: Sequence[str] | None = None) -> None:
    """Compare a composed tree with the signatures it names, before anything is built.

    Args:
        cfg: the tree; every mapping with a `_target_` is compared with that class.
        root_keys: keys allowed at the root; None allows any.
        packages: packages whose classes may be named; None: `PACKAGES` and those of `OMNIOCC_PACKAGES`.

    Raises:
        ConfigError: with every problem found: unknown, missing, unresolvable and wrongly typed arguments.
    """
    problems = []
    if root_keys is not None:
        problems += [_unknown(str(key), "train.py", root_keys) for key in cfg if key not in root_keys]
    problems += _walk(cfg, "", allowed(PACKAGES) if packages is None else packages)
    if problems:
        raise ConfigError([problem.lstrip(".") for problem in problems])


def refuse_credentials(tree: Any) -> None:
    """Check that no text of a tree, or of a list of overrides, is a URL with a password or another secret.

    Configurations and commands are written into results, tables, checkpoints and W&B.

    Raises:
        ConfigError: naming the key, but not the secret.
    """
    told = [(key, credentials_problem(text)) for key, text in _texts(tree, "")]
    if problems := [f"{key}={problem}" if key else problem for key, problem in told if problem]:
        raise ConfigError(problems)


def _texts(node: Any, path: str) -> Iterator[tuple[str, str]]:
    """Yield the texts of a tree with their keys, those of interpolations too; keys of mappings count as texts."""
    if isinstance(node, str):
        yield path, node
    if isinstance(node, ListConfig | list | tuple):
        yield from (found for item in _resolved(node, range(len(node))).values() for found in _texts(item, path))
    if isinstance(node, DictConfig | Mapping):
        yield from ((path, str(key)) for key in node)
        for key, value in _resolved(node, node).items():
            yield from _texts(value, f"{path}.{key}".lstrip("."))


def _resolved(node: Any, keys: Iterable[Any]) -> dict[Any, Any]:
    """Return the values of a node by their keys, without those that are missing or refer to nothing."""
    found = {}
    for key in keys:
        with contextlib.suppress(OmegaConfBaseException):  # `check` names it
            found[key] = node[key]
    return found


ROOT: dict[str, Any] = {
    "name": str,
    "seed": int,
    "resume": str,
    "weights": str | None,
    "stage": str | None,
    "checkpoint_every_n_steps": Number,
    "test_images": NumberOrNone,
    "ema_decay": Kept | None,  # pyright: ignore[reportOperatorIssue]
    "lr_multipliers": dict[str, Weight] | None,
    "occupied_above": Probability | None,  # pyright: ignore[reportOperatorIssue]
    "packages": list[str],
    "plan": bool,
}
"""The plain keys at the root of `train.yaml`, besides the groups, and their types."""
GROUPS = ("preset", "stages", "depth", "model", "data", "loss", "optimizer", "augment", "appearance")
GROUPS += ("callbacks", "trainer", "logger", "paths")
"""The groups at the root of `train.yaml`."""
NAMES = ("name", "preset.name", "logger.group")
"""Keys whose values files, folders and groups of runs are called by."""
NOT_OF_TRAINER = {
    "callbacks": "an own callback is an entry of the root key callbacks, +callbacks=<option>",
    "logger": "train.py makes the loggers: choose by logger.mode=...",
    "plugins": "train.py makes the plugins",
    "default_root_dir": "a run lives in <paths.runs>/<name>-<hash>",
    "enable_progress_bar": "progress is printed in any case",
    "enable_checkpointing": "a run goes on from its checkpoints",
    "fast_dev_run": "preset=smoke trains a few steps of everything",
    "max_steps": "it is stages.occupancy.max_steps now; trainer is the machine, for all stages",
    "max_epochs": "it is stages.occupancy.max_epochs now; trainer is the machine, for all stages",
    "check_val_every_n_epoch": "it is stages.occupancy.validate_every_n_epochs now",
}
"""Arguments of Lightning's trainer that would have no effect or break a run, and what there is instead."""
OF_TRAINER: dict[str, Any] = {
    "precision": Literal["32-true", "bf16-mixed", "16-mixed", "32", "bf16", "16", 32, 16],
    "gradient_clip_val": Weight | None,  # pyright: ignore[reportOperatorIssue]
    "accumulate_grad_batches": Number,
    "log_every_n_steps": NumberOrNone | None,  # pyright: ignore[reportOperatorIssue]
    "num_sanity_val_steps": Limit | None,  # pyright: ignore[reportOperatorIssue]
    "num_nodes": Count,
    **dict.fromkeys(("limit_train_batches", "limit_val_batches", "limit_test_batches"), Batches | None),
}
"""Types of arguments of Lightning's trainer with which a run ends well.

Precision is 32 bits or mixed, because parts of ours stay in 32 bits. Limits of batches are above 0, because every split
is read."""


def check_root(cfg: DictConfig) -> None:
    """Check the whole tree of `train.yaml`, with its root keys and their types.

    Raises:
        ConfigError: with every problem found.
    """
    if "sweep" in cfg:
        raise ConfigError(["sweep: a table is trained by python src/train.py --multirun +sweep=<table>"])
    if lacking := [group for group in GROUPS if group not in cfg]:
        instead = {"logger": "; logger.mode=disabled leaves the curves in a CSV file alone"}
        raise ConfigError([f"{key}: train.py needs it; leave ~{key} out{instead.get(key, '')}" for key in lacking])
    problems = _wrong_values(cfg, ROOT)
    problems += _options_as_values(cfg)
    more = [] if problems else list(cfg.packages)
    problems += [] if problems else _wrong_names(cfg)
    problems += [f"packages: {name} {NOT_THERE}" for name in more if spec_of(name) is None]
    problems += [f"trainer.{key}: {reason}" for key, reason in NOT_OF_TRAINER.items() if key in cfg.get("trainer", ())]
    try:
        check(cfg, (*ROOT, *GROUPS), allowed(PACKAGES, more))
    except ConfigError as error:
        said = {problem.partition(": ")[2] for problem in problems}  # seed=abc: once, not for every stage that takes it
        problems += [problem for problem in error.problems if problem.partition(": ")[2] not in said]
    if problems:
        raise ConfigError([problem.lstrip(".") for problem in problems])


def check_values(cfg: DictConfig, hints: Mapping[str, Any]) -> None:
    """Compare plain values at the root of a configuration with their types.

    Raises:
        ConfigError: with every value that does not fit.
    """
    if problems := _wrong_values(cfg, hints):
        raise ConfigError([problem.lstrip(".") for problem in problems])


def _wrong_values(cfg: DictConfig, hints: Mapping[str, Any]) -> list[str]:
    return [problem for key, hint in hints.items() for problem in _check_value(cfg, key, "", hint)]


def _options_as_values(cfg: DictConfig) -> Iterator[str]:
    for slot in sorted(path.name for path in (CONF / "model").iterdir() if path.is_dir()):
        option = cfg.model.get(slot)
        if isinstance(option, str):
            yield f"model.{slot}={option}: options are chosen with a slash, model/{slot}={option}"


def _wrong_names(cfg: DictConfig) -> Iterator[str]:
    for key in NAMES:
        try:
            if (name := OmegaConf.select(cfg, key)) is not None:
                checked_name(key, name)
        except ValueError as error:
            yield str(error)


def target_of(node: Mapping[Any, Any]) -> type:
    """Return the class that a node of a configuration names; nothing is built.

    The node may be from a file of somebody else, and importing a module runs it: of other packages than the allowed
    ones only modules are taken that are imported already, since they were checked.

    Raises:
        ConfigError: when it cannot be imported, or is of a package that is not allowed.
    """
    name = str(node["_target_"])
    package, module = name.partition(".")[0], name.rpartition(".")[0]
    if package not in allowed(OWN_PACKAGE) and module not in sys.modules:
        raise ConfigError([f"{name} is of the package {package}; allow it by {PACKAGES_VARIABLE}={package}"])
    try:
        return get_object(name)
    except Exception as error:  # a user's module may raise anything
        raise ConfigError([f"{name} cannot be imported: {error}"]) from error


def build(cfg: DictConfig, **extra: Any) -> Any:
    """Build the object a checked node names; modules get plain lists and dicts.

    Raises:
        ConfigError: when a constructor refuses a value.
    """
    try:
        return instantiate(cfg, _convert_="all", **extra)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ValueError | FileNotFoundError):
            raise ConfigError([f"{refused_key(error) or cfg._get_full_key(None)}: {cause}"]) from cause
        raise cause or error from None


def refused_key(error: InstantiationException) -> str:
    """Return the key of the node that could not be built, empty where Hydra does not name it."""
    return str(error).rsplit("full_key: ", 1)[-1] if "full_key: " in str(error) else ""


def as_options(kind: type[Options], key: str, values: Mapping[str, Any]) -> Options:
    """Return the options of a command: a dataclass, compared with its types; `key` names them in messages.

    Raises:
        ConfigError: with every option that is unknown, missing or of the wrong type, or that the class refuses.
    """
    node = OmegaConf.create({key: {"_target_": f"{kind.__module__}.{kind.__name__}", **values}})
    check(node)
    return build(node[key])


def plain(cfg: DictConfig, resolve: bool = True) -> dict[str, Any]:
    """Return the whole tree, with the values of references (`${...}`) if asked, as plain dicts and lists."""
    return {str(key): value for key, value in cast(dict, OmegaConf.to_container(cfg, resolve=resolve)).items()}


def dotted(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of a plain tree by their keys as on the command line: `{"a": {"b": 1}}` is `{"a.b": 1}`."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= dotted(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return found


def compose_plain(folder: Path, name: str, overrides: Sequence[str], resolve: bool = True) -> dict[str, Any]:
    """Return the tree that a script would get from `<folder>/<name>.yaml` as plain dicts and lists; see `plain`.

    Raises:
        ConfigError: when it cannot be composed.
    """
    refuse_credentials(overrides)
    try:
        with initialize_config_dir(str(folder.resolve()), version_base=VERSION_BASE):
            tree = plain(compose(name, list(overrides)), resolve)
    except (HydraException, OmegaConfBaseException) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ConfigError([f"{folder / name}.yaml with {' '.join(overrides)}: {first}"]) from error
    refuse_credentials(tree)
    return tree


PLAIN = re.compile(r"(\.{0,2}/)?[A-Za-z_][\w./-]*")
"""Texts that an override takes for a text without quotes."""


def quoted(text: str) -> str:
    """Return a text as the value of an override, whatever characters it has; plain paths and names as they are."""
    if PLAIN.fullmatch(text) and text.lower() not in ("null", "true", "false", "nan", "inf"):
        return text
    escaped = text.replace("'", r"\'")
    return f"'{escaped}'"


def _walk(node: Any, path: str, packages: Sequence[str]) -> Iterator[str]:
    if isinstance(node, DictConfig) and "_target_" in node:
        yield from _check_call(node, path, packages)
    if not isinstance(node, DictConfig | ListConfig):
        return
    tree: Any = node
    for key in tree if isinstance(node, DictConfig) else range(len(tree)):
        # the value of an interpolation is checked at its own place, and that it resolves by _check_call
        if not OmegaConf.is_interpolation(tree, key) and not OmegaConf.is_missing(tree, key):
            yield from _walk(tree[key], f"{path}.{key}".lstrip("."), packages)


def _check_call(node: DictConfig, path: str, packages: Sequence[str]) -> Iterator[str]:
    name = str(node["_target_"])
    target, refusal = _trusted_target(name, packages)
    if target is None:
        yield f"{path}._target_: {refusal}"
        return
    parameters = parameters_of(target)
    hints = _hints(target) | (OF_TRAINER if path == "trainer" else {})
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    for key in map(str, node):
        if key.startswith("_") and key.endswith("_"):
            continue
        if key not in parameters:
            if not open_ended:
                yield _unknown(f"{path}.{key}", name, list(parameters))
            continue
        yield from _check_value(node, key, path, hints.get(key, Any))
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    present = set(node)  # with the keys whose value is missing, which were named above
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and parameter.kind in named and key not in present:
            yield f"{path}.{key}: {name} needs it"


def _trusted_target(name: str, packages: Sequence[str]) -> tuple[type | None, str]:
    """Return the class of this name, or None and why it is refused."""
    package = name.split(".")[0]
    if package not in packages:
        remedy = f"allow it by packages=[{package}] or {PACKAGES_VARIABLE}={package}"
        return None, f"{name} is of the package {package}, which is not allowed here; if you trust it, {remedy}"
    try:
        target = get_object(name)
    except Exception as error:  # a user's module may raise anything
        reason, module = " ".join(str(error).split()), name.rpartition(".")[0]
        return None, f"{name} cannot be imported: {reason} (is it exported by {module}?)"
    # a module's own imports are its attributes too: omniocc.io.os.system is not of omniocc
    if not inspect.isclass(target) or target.__module__.split(".")[0] not in packages:
        return None, f"{name} is not a class of {', '.join(packages)}"
    return target, ""


def parameters_of(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a class; none if it only inherits `*args, **kwargs`."""
    parameters = dict(inspect.signature(target).parameters)
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {} if all(p.kind in variable for p in parameters.values()) else parameters


def _check_value(node: DictConfig, key: str, path: str, hint: Any) -> Iterator[str]:
    if OmegaConf.is_missing(node, key):
        yield f"{path}.{key}: needs a value"
        return
    try:
        value = node[key]
        plain = OmegaConf.to_container(value, resolve=True) if isinstance(value, DictConfig | ListConfig) else value
    except InterpolationKeyError as error:
        absent = re.search("'(.+)'", str(error))
        yield f"{path}.{key}: refers to {absent[1] if absent else error}, which does not exist with the chosen options"
        return
    except OmegaConfBaseException as error:
        yield f"{path}.{key}: {first_line(error)}"
        return
    wrong_seed = key == "seed" and isinstance(plain, int) and not 0 <= plain <= MAX_SEED
    if not fits(plain, hint):
        yield f"{path}.{key}: {plain!r} is not {described(hint)}"
    elif wrong_seed and not OmegaConf.is_interpolation(node, key):
        yield f"{path}.seed: {plain} is not from 0 to {MAX_SEED}"


def _unknown(path: str, owner: str, known: Sequence[str]) -> str:
    close = get_close_matches(path.rsplit(".", 1)[-1], known, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else f" (it has: {', '.join(known)})"
    return f"{path}: {owner} has no such argument{hint}"


def _hints(target: Any) -> dict[str, Any]:
    function = target.__init__ if inspect.isclass(target) and target.__init__ is not object.__init__ else target
    try:
        return get_type_hints(function, include_extras=True)
    except (NameError, TypeError):  # annotations of other libraries that only a type checker can resolve
        return {}
