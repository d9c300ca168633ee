"""Common parts of scripts: configuration from the command line, one-line errors, quiet libraries."""

import functools
import inspect
import logging
import os
import select
import sys
import warnings
from argparse import Action, ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import cv2
import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from omniocc.config import VERSION_BASE, refuse_credentials
from omniocc.errors import UserError
from omniocc.runs.overrides import explain

P = ParamSpec("P")
T = TypeVar("T")
OUTPUT = 1
"""File descriptor of what is printed."""
FULL_ERROR = "HYDRA_FULL_ERROR"
"""Hydra's environment variable; with `1` it raises its errors instead of printing them."""


def lines_not_tracebacks(main: Callable[..., None]) -> Callable[..., None]:
    """Decorate a script's main: users' mistakes end it with only the message and exit code 1.

    Credentials in the configuration or command line are refused before it runs, see `refuse_credentials`.
    """

    @functools.wraps(main)
    def wrapped(*args: Any) -> None:
        try:
            refuse_credentials([*args, sys.argv[1:]])
            main(*args)
        except (UserError, OSError) as error:
            if not (isinstance(error, BrokenPipeError) and output_is_closed()):
                sys.exit(str(error))
        finally:
            output_is_closed()

    return wrapped


def output_is_closed() -> bool:
    """Return whether nothing reads the output any more, since `head` or a pager has seen enough; then write nowhere."""
    output = select.poll()
    output.register(OUTPUT, 0)
    if not output.poll(0):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), OUTPUT)
    return True


def script(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[..., None]]:
    """Return a decorator for a script's main, which gets the configuration composed from `conf/` and the command line.

    Users' mistakes end the script with only the message and exit code 1; for overrides it names the nearest keys or
    options. With `HYDRA_FULL_ERROR=1` Hydra reports mistakes in overrides itself, with a traceback. Jobs of a
    multirun inherit that variable, so that their log files hold whole tracebacks.
    """

    def decorate(main: Callable[[DictConfig], None]) -> Callable[..., None]:
        conf = str(Path(inspect.getfile(main)).resolve().parents[1] / "conf")

        @functools.wraps(main)
        def task(cfg: DictConfig) -> None:
            if setting is None:
                os.environ.pop(FULL_ERROR, None)  # later errors are reported as usual
            lines_not_tracebacks(main)(cfg)

        run = accept_lazy_help(hydra.main(version_base=VERSION_BASE, config_path=conf, config_name=config_name)(task))
        setting = os.environ.get(FULL_ERROR)

        @functools.wraps(main)
        @lines_not_tracebacks  # around Hydra too, which writes the command line of a multirun
        def wrapped(*args: Any) -> None:
            if setting is not None:
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


def quiet_libraries() -> None:
    """Turn off the banners, tips and known harmless warnings of other libraries."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.ERROR)
    os.environ.setdefault("TOKENIZERS_PARALLELISM", "false")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # in processes; damaged images have errors of ours
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    warnings.filterwarnings("ignore", module="lightning")
    warnings.filterwarnings("ignore", module="torch.utils.data")
    warnings.filterwarnings("ignore", message="Grad strides do not match bucket view strides")
