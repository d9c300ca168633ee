"""Old names of arguments, which work for one more release."""

import functools
import inspect
import warnings
from collections.abc import Callable, Mapping
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

END = "0.2"
"""The version in which the old names are gone."""


def renamed(names: Mapping[str, str]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator by which a function takes arguments by their old names too, with a `FutureWarning`.

    Args:
        names: the new name of each old one.

    Raises:
        TypeError: in a call that gives an argument by both names.

    Example:
        >>> @renamed({"prediction": "preds"})
        ... def count(preds, target):
        ...     return len(preds) + len(target)
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     count(prediction=[1, 2], target=[3])
        3
        >>> print(caught[0].message)
        count(): the argument 'prediction' is called 'preds' now; the old name is gone in version 0.2
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> R:
            for old, new in names.items():
                if old in kwargs:
                    if new in kwargs:
                        raise TypeError(f"{function.__name__}() got '{new}' and its old name '{old}'")
                    text = f"the argument '{old}' is called '{new}' now; the old name is gone in version {END}"
                    warnings.warn(f"{function.__name__}(): {text}", FutureWarning, stacklevel=2)
                    kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        # a collection of torchmetrics hands over only the arguments that it finds in the signature
        signature = inspect.signature(function)
        old_names = [inspect.Parameter(old, inspect.Parameter.KEYWORD_ONLY, default=None) for old in names]
        called.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *old_names])  # type: ignore[attr-defined]
        return called

    return decorate
