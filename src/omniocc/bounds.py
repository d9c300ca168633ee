"""Types of arguments, ranges of numbers among them, with which a configuration is compared before anything is built."""

import inspect
import math
import sys
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin


@dataclass(frozen=True)
class Within:
    """A range of numbers, the metadata of an `Annotated` type.

    Attributes:
        low: smallest number.
        high: largest number.
        open_low: whether `low` itself is left out.
        open_high: whether `high` itself is left out.
    """

    low: int | float
    high: int | float
    open_low: bool = False
    open_high: bool = False

    def holds(self, value: int | float) -> bool:
        """Return whether a number is in the range."""
        above = self.low < value if self.open_low else self.low <= value
        return above and (value < self.high if self.open_high else value <= self.high)

    def __str__(self) -> str:
        if not (self.open_low or self.open_high):
            return f"from {self.low:,} to {self.high:,}"
        low = f"above {self.low:,}" if self.open_low else f"from {self.low:,} on"
        return f"{low} and {'below' if self.open_high else 'at most'} {self.high:,}"


Real = float | int
"""A number; a configuration may state it without a point."""
Size = Annotated[int, Within(1, 65_536)]
"""Channels of a network, classes, pixels, bins."""
SizeOrNone = Annotated[int, Within(0, 65_536)]
"""The same where 0 leaves the part out."""
Count = Annotated[int, Within(1, 1000)]
"""Layers, heads, samples, frames of a window: each takes time or memory of its own."""
CountOrNone = Annotated[int, Within(0, 1000)]
"""The same where 0 leaves the part out."""
Number = Annotated[int, Within(1, 10**9)]
"""Steps, epochs, samples, scenes and frames."""
NumberOrNone = Annotated[int, Within(0, 10**9)]
"""The same where 0 means none."""
Limit = Annotated[int, Within(-1, 10**9)]
"""Steps or epochs after which something ends; -1: it does not."""
Weight = Annotated[Real, Within(0, 10**6)]
"""Factors of losses and learning rates, and limits of a norm; 0 leaves out what they multiply."""
Fraction = Annotated[Real, Within(0, 1)]
Probability = Annotated[Real, Within(0, 1, open_low=True, open_high=True)]
"""A limit that divides what is likely from what is not."""
Kept = Annotated[Real, Within(0, 1, open_high=True)]
"""Fractions of a running mean that are kept in each step; at 1 it would never change."""
Rate = Annotated[Real, Within(0, 100, open_low=True)]
"""Learning rates."""
Degrees = Annotated[Real, Within(0, 180)]
"""Turns to either side."""
Batches = Annotated[int, Within(1, 10**9)] | Annotated[Real, Within(0, 1, open_low=True)]
"""How much is read of a split: batches, or a fraction of them."""
Metres = Annotated[Real, Within(0, 1000)]
"""Distances on a grid, m."""
Seconds = Annotated[Real, Within(0, 3600, open_low=True)]
"""Times between frames, s."""


def fits(value: Any, hint: Any) -> bool:
    """Return whether a plain configuration value fits a type hint.

    Objects to be built (`_target_`) always fit, and every value fits hints of kinds that are not handled here.
    """
    if isinstance(value, dict) and "_target_" in value:
        return True
    if hint in (bool, str, type(None)):
        return isinstance(value, hint)
    if hint in (int, float):
        if isinstance(value, int) and not isinstance(value, bool):
            return abs(value) <= sys.float_info.max
        return isinstance(value, hint) and not isinstance(value, bool) and math.isfinite(value)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        ranges = [part for part in arguments[1:] if isinstance(part, Within)]
        return fits(value, arguments[0]) and all(part.holds(cast(float, value)) for part in ranges)
    if origin is Literal:
        return value in arguments
    if origin in (Union, types.UnionType):
        return any(fits(value, option) for option in arguments)
    if origin is tuple and isinstance(value, list | tuple):
        items = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        return len(items) == len(value) and all(map(fits, value, items))
    if origin in (dict, Mapping):
        return isinstance(value, Mapping) and all(fits(item, arguments[1]) for item in value.values())
    if inspect.isclass(origin) and issubclass(origin, Sequence):
        return isinstance(value, list | tuple) and all(fits(item, arguments[0]) for item in value)
    return True


def described(hint: Any) -> str:
    """Return a type hint in words, for a message: 'a whole number from 1 to 1,000'."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return " ".join([described(arguments[0]), *map(str, arguments[1:])])
    if origin is Literal:
        return "one of " + ", ".join(map(repr, arguments))
    if hint == Real:
        return described(float)
    if origin in (Union, types.UnionType):
        return " or ".join(map(described, arguments))
    if origin in (list, Sequence, dict, Mapping) and get_origin(arguments[-1]) is Annotated:
        return f"{'a list' if origin in (list, Sequence) else 'a mapping'}, each {described(arguments[-1])}"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text", type(None): "null"}
    return names.get(hint) or str(hint)
