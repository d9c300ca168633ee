"""Compose the configuration from the command line, check it, build objects; alone in calling Hydra's `instantiate`."""

import functools
import inspect
import os
import re
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher, get_close_matches
from pathlib import Path
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import hydra
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, InterpolationKeyError, OmegaConfBaseException

from omniocc.errors import UserError
from omniocc.lazy_help import accept_lazy_help

MAX_SEED = 2**32 - 1
"""The largest seed that numpy and Lightning take."""
FULL_ERROR = "HYDRA_FULL_ERROR"
"""Hydra's environment variable; `1` makes it raise its errors instead of printing them."""
VERSION_BASE = "1.3"
NEAREST_KEYS = 3
NEAR_ENOUGH = 0.6


class ConfigError(UserError):
    """What is wrong in a configuration, all of it, one line each."""

    def __init__(self, problems: Sequence[str]):
        self.problems = tuple(problems)
        noun = "problem" if len(problems) == 1 else "problems"
        super().__init__("\n  ".join([f"{len(problems)} {noun} in the configuration:", *problems]))


def check(cfg: DictConfig, root_keys: Sequence[str] | None = None, packages: Sequence[str] | None = None) -> None:
    """Compare a composed tree with the signatures it names, before anything is built.

    Args:
        cfg: the tree; every mapping with a `_target_` is compared with that class or function.
        root_keys: keys allowed at the root; None allows any.
        packages: packages that a `_target_` may come from (for configurations out of files of others); None allows any.

    Raises:
        ConfigError: with every problem found: unknown, missing, unresolvable and wrongly typed arguments.
    """
    problems = []
    if root_keys is not None:
        problems += [_unknown(str(key), "train.py", root_keys) for key in cfg if key not in root_keys]
    problems += _walk(cfg, "", packages)
    if problems:
        raise ConfigError([problem.lstrip(".") for problem in problems])


@dataclass
class Root:
    """The plain keys at the root of `train.yaml`; groups stand beside them."""

    name: str
    seed: int
    resume: str
    stage: str | None
    checkpoint_every_n_steps: int
    pictures: int
    ema_decay: float | None


GROUPS = ("preset", "stages", "depth", "model", "data", "loss", "optimizer", "augment", "trainer", "logger", "paths")


def check_root(cfg: DictConfig) -> None:
    """`check` for the whole tree of `train.yaml`, with its root keys and their types.

    Raises:
        ConfigError: with every problem found.
    """
    hints = get_type_hints(Root)
    problems = [problem for key, hint in hints.items() for problem in _check_value(cfg, key, "", hint)]
    try:
        check(cfg, root_keys=(*hints, *GROUPS))
    except ConfigError as error:
        problems += error.problems
    if problems:
        raise ConfigError([problem.lstrip(".") for problem in problems])


def build(cfg: DictConfig, **extra: Any) -> Any:
    """Build the object a checked node names; modules get plain lists and dicts.

    Args:
        cfg: the node.
        extra: arguments that no file can hold.

    Raises:
        ConfigError: when a constructor refuses a value.
    """
    try:
        return instantiate(cfg, _convert_="all", **extra)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ValueError | FileNotFoundError):
            raise ConfigError([f"{_refused_key(error) or cfg._get_full_key(None)}: {cause}"]) from cause
        raise cause or error from None


def plain(cfg: DictConfig) -> dict[str, Any]:
    """The whole tree, resolved, as plain dicts and lists."""
    return {str(key): value for key, value in cast(dict, OmegaConf.to_container(cfg, resolve=True)).items()}


def compose_plain(folder: Path, name: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Return the tree that a script would get with these overrides, resolved, as plain dicts and lists.

    Args:
        folder: of the configuration.
        name: of the file at its root, without ending.
        overrides: as on the command line.

    Raises:
        ConfigError: when it cannot be composed.
    """
    try:
        with initialize_config_dir(str(folder.resolve()), version_base="1.3"):
            return plain(compose(name, list(overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ConfigError([f"{folder / name}.yaml with {' '.join(overrides)}: {first}"]) from error


def lines_not_tracebacks(main: Callable[..., None]) -> Callable[..., None]:
    """Decorate a script's main: users' mistakes end it with the message alone and exit code 1."""

    @functools.wraps(main)
    def wrapped(*args: Any) -> None:
        try:
            main(*args)
        except (UserError, OSError) as error:
            sys.exit(str(error))

    return wrapped


def script(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[..., None]]:
    """Return a decorator for a script's main, which gets the configuration composed from `conf/` and the command line.

    Users' mistakes end the script with the message alone and exit code 1; for overrides it names the nearest keys or
    options. With `HYDRA_FULL_ERROR=1` Hydra reports mistakes in overrides itself, with a traceback. Jobs of a
    multirun inherit that variable, so that their log files hold whole tracebacks.

    Args:
        config_name: of the root file in `conf/`.
    """

    def decorate(main: Callable[[DictConfig], None]) -> Callable[..., None]:
        conf = str(Path(inspect.getfile(main)).resolve().parents[1] / "conf")

        @functools.wraps(main)
        def task(cfg: DictConfig) -> None:
            if asked is None:
                os.environ.pop(FULL_ERROR, None)  # composed: errors of the code itself are reported as ever
            lines_not_tracebacks(main)(cfg)

        run = accept_lazy_help(hydra.main(version_base=VERSION_BASE, config_path=conf, config_name=config_name)(task))
        asked = os.environ.get(FULL_ERROR)

        @functools.wraps(main)
        def wrapped(*args: Any) -> None:
            if asked is not None:
                return run(*args)
            os.environ[FULL_ERROR] = "1"
            try:
                run(*args)
            except (HydraException, OmegaConfBaseException) as error:
                sys.exit(explain(error, conf, config_name, sys.argv[1:]))
            finally:
                os.environ.pop(FULL_ERROR, None)

        return wrapped

    return decorate


def explain(error: Exception, conf: str, config_name: str, arguments: Sequence[str]) -> str:
    """Return a few lines about a mistake in overrides: the problem first, then what is nearest to what was written.

    Args:
        error: raised while Hydra composed the configuration.
        conf: folder of the configuration.
        config_name: of its root file.
        arguments: of the command line.
    """
    cause = error.__cause__
    if isinstance(error, OverrideParseException):
        reason = str(error.message).removeprefix(f"Error parsing override '{error.override}'").strip().splitlines()[0]
        problem = f"{error.override}: this cannot be read as key=value ({reason})"
        return f"{problem}\n  quote lists and texts with commas: 'key=[1,2]'"
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, option = error.missing_cfg_file.rpartition("/")
        close = get_close_matches(option, error.options, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        return f"{group}={option}: there is no such option{hint}\n  options: {', '.join(sorted(error.options))}"
    if isinstance(error, InstantiationException) and cause is not None:
        return f"{_refused_key(error)}: {cause}"
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.full_key:
        return _unknown_key(str(cause.full_key), *_names(conf, config_name, cause.full_key, arguments))
    lines = [*str(error).split("Config search path")[0].splitlines(), *str(cause or "").splitlines()[:1]]
    return "\n  ".join([line.strip() for line in lines if line.strip()])


def _unknown_key(key: str, keys: Sequence[str], groups: Sequence[str]) -> str:
    """Return the lines about a key that is not there; a key with a slash was meant as a group."""
    close = nearest(key, groups if "/" in key else [*keys, *groups])
    if close:
        hint = f"; did you mean {' or '.join(close)}?"
    else:
        parent = next((p for p in _parents(key) if any(k.startswith(f"{p}.") for k in keys)), "")
        within = [k.removeprefix(f"{parent}.") for k in keys if not parent or k.startswith(f"{parent}.")]
        children = groups if "/" in key else [child for child in within if "." not in child]
        hint = f"\n  {'groups' if '/' in key else parent or 'keys'}: {', '.join(children)}"
    return f"{key}: there is no such key{hint}"


def nearest(wanted: str, known: Sequence[str]) -> list[str]:
    """Return the few most similar of known dotted or slashed names, best first; their last parts count by half."""

    def likeness(name: str) -> float:
        last = SequenceMatcher(None, _last(wanted), _last(name)).ratio()
        return (SequenceMatcher(None, wanted, name).ratio() + last) / 2

    scored = sorted(((likeness(name), name) for name in known), key=lambda item: -item[0])
    return [name for score, name in scored[:NEAREST_KEYS] if score >= NEAR_ENOUGH]


def _last(name: str) -> str:
    return re.split(r"[./]", name)[-1]


def _parents(key: str) -> Iterator[str]:
    while "." in key:
        key = key.rpartition(".")[0]
        yield key


def _names(conf: str, config_name: str, wrong: str, arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return all keys and groups of the configuration composed without the wrong override, or without any."""
    overrides = [a for a in arguments if "=" in a and not a.startswith("-") and wrong not in a.split("=")[0]]
    with hydra.initialize_config_dir(conf, version_base=VERSION_BASE):
        try:
            cfg = hydra.compose(config_name, overrides, return_hydra_config=True)
        except HydraException:  # another mistake, or values to sweep over
            cfg = hydra.compose(config_name, return_hydra_config=True)
    tree = cast(dict, OmegaConf.to_container(cfg, resolve=False))
    options = tree.pop("hydra")
    keys = [*_keys(tree, ""), *_keys(options["launcher"], "hydra.launcher.")]
    groups = [group for group in options["runtime"]["choices"] if "@" not in group and not group.startswith("hydra/")]
    return [key for key in keys if not _last(key).startswith("_")], groups


def _keys(tree: dict, prefix: str) -> Iterator[str]:
    for key, value in tree.items():
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")


def _refused_key(error: InstantiationException) -> str:
    """Return the key of the node that could not be built, empty if Hydra does not name it."""
    return str(error).rsplit("full_key: ", 1)[-1] if "full_key: " in str(error) else ""


def _walk(node: Any, path: str, packages: Sequence[str] | None) -> Iterator[str]:
    if isinstance(node, DictConfig) and "_target_" in node:
        yield from _check_call(node, path, packages)
    if not isinstance(node, DictConfig | ListConfig):
        return
    tree: Any = node
    for key in tree if isinstance(node, DictConfig) else range(len(tree)):
        # what an interpolation points to is checked where it stands; whether it resolves, by _check_call
        if not OmegaConf.is_interpolation(tree, key) and not OmegaConf.is_missing(tree, key):
            yield from _walk(tree[key], f"{path}.{key}".lstrip("."), packages)


def _check_call(node: DictConfig, path: str, packages: Sequence[str] | None) -> Iterator[str]:
    name = str(node["_target_"])
    if packages is not None and not name.startswith(tuple(f"{package}." for package in packages)):
        yield f"{path}._target_: {name} is not in a trusted package ({', '.join(packages)})"
        return
    try:
        target = get_object(name)
    except Exception as error:  # whatever importing the user's module raises is the user's problem to read
        yield f"{path}._target_: {name} cannot be imported: {error}"
        return
    parameters = parameters_of(target)
    hints = _hints(target)
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    for key in map(str, node):
        if key.startswith("_") and key.endswith("_"):
            continue
        if key not in parameters:
            if not open_ended:
                yield _unknown(f"{path}.{key}", name, list(parameters))
            continue
        yield from _check_value(node, key, path, hints.get(key, Any))
    for key, parameter in parameters.items():
        if (
            parameter.default is inspect.Parameter.empty
            and key not in node
            and parameter.kind in (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        ):
            yield f"{path}.{key}: {name} needs it"


def parameters_of(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """What can be passed by name; a class with nothing but the `*args, **kwargs` of a base class takes nothing."""
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
        yield f"{path}.{key}: takes {absent[1] if absent else error}, which is not in this choice of options"
        return
    except OmegaConfBaseException as error:
        yield f"{path}.{key}: {str(error).splitlines()[0]}"
        return
    if not fits(plain, hint):
        yield f"{path}.{key}: {plain!r} is not {_describe(hint)}"
    elif key == "seed" and _is_out_of_range(plain) and not OmegaConf.is_interpolation(node, key):
        yield f"{path}.seed: {plain} is not from 0 to {MAX_SEED}"


def _is_out_of_range(seed: Any) -> bool:
    return isinstance(seed, int) and not 0 <= seed <= MAX_SEED


def _unknown(path: str, owner: str, known: Sequence[str]) -> str:
    close = get_close_matches(path.rsplit(".", 1)[-1], known, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else f" (it has: {', '.join(known)})"
    return f"{path}: {owner} has no such argument{hint}"


def _hints(target: Any) -> dict[str, Any]:
    function = target.__init__ if inspect.isclass(target) and "__init__" in vars(target) else target
    try:
        return get_type_hints(function)
    except (NameError, TypeError):  # annotations of other libraries that only a type checker can resolve
        return {}


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain configuration value can be passed where `hint` is asked for.

    What is built (`_target_`) and hints we do not know fit.
    """
    if isinstance(value, dict) and "_target_" in value:
        return True
    if hint is bool or hint is str:
        return isinstance(value, hint)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is type(None):
        return value is None
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        return value in arguments
    if origin in (Union, types.UnionType):
        return any(fits(value, option) for option in arguments)
    if origin is tuple and isinstance(value, list | tuple):
        items = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        return len(items) == len(value) and all(map(fits, value, items))
    if inspect.isclass(origin) and issubclass(origin, Sequence):
        return isinstance(value, list | tuple) and all(fits(item, arguments[0]) for item in value)
    return True


def _describe(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(repr, get_args(hint)))
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(map(_describe, get_args(hint)))
    return {int: "a whole number", float: "a number", bool: "true or false", str: "a text", type(None): "null"}.get(
        hint
    ) or str(hint)
