"""Hydra 1.3 on Python 3.14: argparse refuses a help text that is made only when it is shown."""

import functools
from argparse import Action, ArgumentParser
from collections.abc import Callable
from typing import ParamSpec, TypeVar
from unittest.mock import patch

P = ParamSpec("P")
T = TypeVar("T")


def accept_lazy_help(main: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that argparse leaves help texts that are no strings unchecked while it runs.

    Python 3.14 checks every help text when its argument is added and ends with 'badly formed help string' at Hydra's
    `--shell-completion`. Strings are checked as before; Python 3.13 and older check nothing.
    """

    @functools.wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        check = getattr(ArgumentParser, "_check_help", None)
        if check is None:
            return main(*args, **kwargs)

        def check_strings(parser: ArgumentParser, action: Action) -> None:
            if isinstance(action.help, str):
                check(parser, action)

        with patch.object(ArgumentParser, "_check_help", check_strings):
            return main(*args, **kwargs)

    return run
