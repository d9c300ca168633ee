"""Random numbers that depend on the purpose of a draw, not on the order of draws."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

Option = TypeVar("Option")


def generator(theme: str, seed: int, purpose: str) -> np.random.Generator:
    """Return the generator of one purpose ('network', 'traffic', ...) in the world of a theme and a seed.

    Every process gets the same numbers from it. Renaming a purpose changes its numbers in every world.
    """
    digest = hashlib.sha256(f"{theme}/{seed}/{purpose}".encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype="<u4"))


def choice(rng: np.random.Generator, options: Sequence[Option]) -> Option:
    """Return one of the options, all equally likely."""
    return options[int(rng.integers(len(options)))]


def weighted_choice(rng: np.random.Generator, weights: Mapping[str, float | int]) -> str:
    """Return one key of `weights`, drawn with a probability proportional to its weight."""
    names = list(weights)
    cumulative = np.cumsum([weights[name] for name in names])
    return names[int(np.searchsorted(cumulative, rng.uniform() * cumulative[-1], side="right"))]
