"""Common parts of scripts: configuration from the command line, one-line errors, quiet libraries."""

import codecs
import functools
import logging
import os
import re
import select
import signal
import sys
import unicodedata
import warnings
from argparse import Action, ArgumentParser
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher, get_close_matches
from errno import EDQUOT, ENOSPC, EROFS
from io import TextIOWrapper
from itertools import accumulate
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import hydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from omniocc.config import (
    CONF,
    NOT_OF_TRAINER,
    VERSION_BASE,
    ConfigError,
    compose_plain,
    refuse_credentials,
    refused_key,
)
from omniocc.errors import INTERRUPTED, LOADER_ENDED, UserError
from omniocc.io import cannot_write
from omniocc.runs.help import help_text
from omniocc.runs.renamed import new_key

P = ParamSpec("P")
T = TypeVar("T")
OUTPUT = 1
"""File descriptor of what is printed."""
SUBSTITUTE = "omniocc.substitute"
"""Name of the error handler of codecs that writes other characters for those an encoding lacks."""
SUBSTITUTES = {"–": "-", "—": "-", "±": "+/-", "×": "x", "μ": "u", "µ": "u", "°": " deg", "✓": "yes"}
SUBSTITUTES |= {"✅": "yes", "☑": "(yes)", "❌": "no"}
"""What is written for characters of our texts; others are decomposed (… is ...), or become a question mark."""
HELP = ("-h", "--help")
FULL_ERROR = "HYDRA_FULL_ERROR"
"""Hydra's environment variable; with `1` it raises its errors instead of printing them."""


def lines_not_tracebacks(main: Callable[..., None], again: str = "") -> Callable[..., None]:
    """Decorate a script's main: users' mistakes end it with only the message and exit code 1, Ctrl-C with 130.

    Credentials in the configuration or command line are refused before it runs, see `refuse_credentials`. What it
    prints is written to terminals of any encoding, see `substitute`. `again` says after Ctrl-C what the same command
    does.
    """

    @functools.wraps(main)
    def wrapped(*args: Any) -> None:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors=SUBSTITUTE)
        try:
            refuse_credentials([*args, sys.argv[1:]])
            main(*args)
        except (UserError, OSError) as error:
            if not (isinstance(error, BrokenPipeError) and output_is_closed()):
                sys.exit(line_of(error))
        except RuntimeError as error:
            if not LOADER_ENDED.match(str(error)):
                raise
            sys.exit(
                "a process that reads the data was killed (out of memory?). Run the same command again, perhaps with a "
                "smaller data.num_workers; a training goes on from its checkpoint"
            )
        except (KeyboardInterrupt, SystemExit) as end:
            if not is_ctrl_c(end):
                raise
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # a second one ends at once
            print("; ".join(filter(None, ["stopped by Ctrl-C", again])), file=sys.stderr)
            sys.exit(INTERRUPTED)
        finally:
            output_is_closed()

    return wrapped


def substitute(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return what is written for characters that the encoding of a terminal or log lacks; an error handler of codecs.

    A letter loses its accent. Bytes of a file name that no character stands for are written as they are.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    if "\udc80" <= character <= "\udcff":
        return bytes([ord(character) - 0xDC00]), error.start + 1
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return SUBSTITUTES.get(character, plain or "?"), error.start + 1


codecs.register_error(SUBSTITUTE, substitute)


def is_ctrl_c(end: BaseException) -> bool:
    """Return whether Ctrl-C has raised this, or Lightning's exit with code 1 that hides it."""
    lightning = isinstance(end, SystemExit) and end.code == 1 and isinstance(end.__context__, KeyboardInterrupt)
    return lightning or isinstance(end, KeyboardInterrupt)


def line_of(error: UserError | OSError) -> str:
    """Return an error's message, with the remedy where a library finds a disk full or read-only."""
    if isinstance(error, OSError) and error.errno in (ENOSPC, EROFS, EDQUOT) and error.filename is not None:
        return str(cannot_write(Path(error.filename), error))
    return str(error)


def output_is_closed() -> bool:
    """Return whether nothing reads the output any more, since `head` or a pager has seen enough; then write nowhere."""
    output = select.poll()
    output.register(OUTPUT, 0)
    if not output.poll(0):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), OUTPUT)
    return True


def script(config_name: str, again: str = "") -> Callable[[Callable[[DictConfig], None]], Callable[..., None]]:
    """Return a decorator for a script's main, which gets the configuration composed from `conf/` and the command line.

    Users' mistakes end the script with only the message and exit code 1; for overrides it names the nearest keys or
    options. With `HYDRA_FULL_ERROR=1` Hydra reports mistakes in overrides itself, with a traceback. Jobs of a
    multirun inherit that variable, so that their log files hold whole tracebacks. `again` says after Ctrl-C what the
    same command does.
    """

    def decorate(main: Callable[[DictConfig], None]) -> Callable[..., None]:
        unset = False  # whether the variable was set by this function alone

        @functools.wraps(main)
        def task(cfg: DictConfig) -> None:
            if unset:
                os.environ.pop(FULL_ERROR, None)  # later errors are reported as usual
            lines_not_tracebacks(main, again)(cfg)

        start = hydra.main(version_base=VERSION_BASE, config_path=str(CONF), config_name=config_name)
        run = accept_lazy_help(start(task))

        def help_or_run(*args: Any) -> None:
            if {"-h", "--help"} & set(sys.argv[1:]):
                print(help_text(config_name, [word for word in sys.argv[1:] if not word.startswith("-")]))
            else:
                run(*args)

        @functools.wraps(main)
        @lines_not_tracebacks  # around Hydra too, which writes the command line of a multirun
        def wrapped(*args: Any) -> None:
            nonlocal unset
            unset = FULL_ERROR not in os.environ
            if not unset:
                return help_or_run(*args)
            os.environ[FULL_ERROR] = "1"
            try:
                help_or_run(*args)
            except (HydraException, OmegaConfBaseException) as error:
                sys.exit(explain(error, str(CONF), config_name, sys.argv[1:]))
            finally:
                os.environ.pop(FULL_ERROR, None)

        return wrapped

    return decorate


def accept_lazy_help(main: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that argparse does not check help texts that are no strings while it runs.

    Python 3.14 checks every help text when its argument is added and ends with 'badly formed help string' at the
    `--shell-completion` of Hydra 1.3, whose text is made only when it is shown. Strings are checked as before; Python
    3.13 and older check nothing.
    """

    @functools.wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        check = getattr(ArgumentParser, "_check_help", None)
        if check is None:
            return main(*args, **kwargs)

        def check_strings(parser: ArgumentParser, action: Action) -> None:
            if isinstance(action.help, str):
                check(parser, action)

        ArgumentParser._check_help = check_strings  # type: ignore[attr-defined]
        try:
            return main(*args, **kwargs)
        finally:
            ArgumentParser._check_help = check  # type: ignore[attr-defined]

    return run


def chosen_command(commands: Mapping[str, Callable[..., None]], script: str) -> str:
    """Take the command that the first argument names from the command line, and return it.

    Without one of `commands` print how `script` is used, with the first line of each docstring, and exit: with code 2
    unless that was asked for.
    """
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    if word in commands:
        return sys.argv.pop(1)
    print_unknown_command(word, [*commands])
    print(f"usage: python src/{script} <command> key=value ...    (<command> --help lists its keys)\n")
    for name, main in commands.items():
        print(f"  {name:{max(map(len, commands))}}  {(main.__doc__ or '').splitlines()[0].rstrip('.')}")
    sys.exit(0 if word in HELP else 2)


def print_unknown_command(word: str, commands: Sequence[str]) -> None:
    """Print on stderr that there is no such command, and the nearest one; nothing without a word or for help."""
    if word and word not in HELP:
        close = get_close_matches(word, commands, n=1)
        print(f"there is no command '{word}'{f'; did you mean {close[0]}?' if close else ''}", file=sys.stderr)


def require(cfg: DictConfig, keys: Sequence[str], command: str) -> None:
    """Check that mandatory keys have a value.

    Raises:
        UserError: naming the first missing key and the command whose `--help` explains it.
    """
    for key in keys:
        if OmegaConf.is_missing(cfg, key):
            raise UserError(f"{key}=... is needed; see python src/{command} --help")


def quiet_libraries() -> None:
    """Turn off the banners, tips and known harmless warnings of other libraries."""
    import cv2  # not before a command builds something, as all that is large: `--help` starts at once

    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.ERROR)
    os.environ.setdefault("TOKENIZERS_PARALLELISM", "false")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # for child processes; damaged images have errors of ours
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    warnings.filterwarnings("ignore", module="lightning")
    warnings.filterwarnings("ignore", module="torch.utils.data")
    warnings.filterwarnings("ignore", message="Grad strides do not match bucket view strides")


NEAREST_KEYS = 3
LAST_OPTIMIZER = "stages.occupancy.optimizer"
NEAR_ENOUGH = 0.6


def explain(error: Exception, conf: str, config_name: str, arguments: Sequence[str]) -> str:
    """Return a few lines about a mistake in overrides: first the problem, then the nearest keys or options.

    Hydra raised the error while it composed the file `config_name` of the folder `conf` with the arguments of the
    command line.
    """
    cause = error.__cause__
    if isinstance(error, OverrideParseException):
        reason = str(error.message).removeprefix(f"Error parsing override '{error.override}'").strip().splitlines()[0]
        remedy = "quote lists, and texts with commas, spaces or other signs: 'key=[1,2]', 'key=\"a b\"'"
        return f"{error.override}: this cannot be read as key=value ({reason})\n  {remedy}"
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        return _unknown_option(error.missing_cfg_file, error.options)
    if isinstance(error, InstantiationException) and cause is not None:
        return f"{refused_key(error)}: {cause}"
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.full_key:
        return _unknown_key(str(cause.full_key), *_names(conf, config_name, cause.full_key, arguments))
    lines = [*str(error).split("Config search path")[0].splitlines(), *str(cause or "").splitlines()[:1]]
    return "\n  ".join([line.strip() for line in lines if line.strip()])


def train_config(overrides: Sequence[str]) -> DictConfig:
    """Return the configuration of `src/train.py` with these overrides.

    Raises:
        UserError: when they are wrong, with the nearest keys or options.
    """
    try:
        return OmegaConf.create(compose_plain(CONF, "train", overrides))
    except ConfigError as error:
        if isinstance(error.__cause__, HydraException | OmegaConfBaseException):
            raise UserError(explain(error.__cause__, str(CONF), "train", overrides)) from error
        raise


def read_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the values of overrides by dotted key, read as on the command line of `src/train.py`.

    Raises:
        UserError: naming one that cannot be read, or has several values to sweep over.
    """
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except OverrideParseException as error:
        raise UserError(explain(error, str(CONF), "train", overrides)) from error
    if several := [override.input_line for override in parsed if override.is_sweep_override()]:
        raise UserError(f"{several[0]}: one value is needed; a list has brackets, key=[1,2]")
    return {override.key_or_group: override.value() for override in parsed}


def _unknown_option(missing: str, options: Sequence[str]) -> str:
    """Return the lines about a missing option such as 'model/sketch/onmi', given the options that Hydra lists."""
    group, _, option = missing.rpartition("/")
    close = get_close_matches(option, options, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"{group}={option}: there is no such option{hint}\n  options: {', '.join(sorted(options))}"


def _unknown_key(key: str, keys: Sequence[str], groups: Sequence[str]) -> str:
    """Return the lines about an unknown key; one with a slash is taken for a group."""
    if key.startswith(f"{LAST_OPTIMIZER}."):
        own = key.removeprefix("stages.occupancy.")
        return f"{key}: the optimiser of the last stage is the group optimizer: {own}=..."
    parent, _, last = key.rpartition(".")
    if parent == "trainer" and last in NOT_OF_TRAINER:
        return f"{key}: {NOT_OF_TRAINER[last]}"
    if (new := new_key(key)) is not None:
        return f"{key}: it is {new} now"
    close = nearest(key, groups if "/" in key else [*keys, *groups])
    if close:
        hint = f"; did you mean {' or '.join(close)}?"
    else:
        parents = list(accumulate(key.split(".")[:-1], "{}.{}".format))
        parent = next((p for p in reversed(parents) if any(k.startswith(f"{p}.") for k in keys)), "")
        within = [k.removeprefix(f"{parent}.") for k in keys if not parent or k.startswith(f"{parent}.")]
        children = groups if "/" in key else [child for child in within if "." not in child]
        hint = f"\n  {'groups' if '/' in key else parent or 'keys'}: {', '.join(children)}"
    if key.startswith("trainer."):
        hint += f"\n  other arguments of Lightning's Trainer are added with a plus: +{key}=..."
    if key.startswith("preset."):
        hint += "\n  a number of a part is changed by the part's own key: model.lifter.layers=..."
    return f"{key}: there is no such key{hint}"


def nearest(name: str, known: Sequence[str]) -> list[str]:
    """Return the most similar of known dotted or slashed names, best first; the last part has half of the weight."""

    def similarity(candidate: str) -> float:
        last = SequenceMatcher(None, _last(name), _last(candidate)).ratio()
        return (SequenceMatcher(None, name, candidate).ratio() + last) / 2

    scored = sorted(
        ((similarity(candidate), candidate) for candidate in dict.fromkeys(known)), key=lambda item: -item[0]
    )
    return [candidate for score, candidate in scored[:NEAREST_KEYS] if score >= NEAR_ENOUGH]


def _last(name: str) -> str:
    return re.split(r"[./]", name)[-1]


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
