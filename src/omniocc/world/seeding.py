"""Random numbers that depend on what they are for, not on the order in which they are drawn."""

import hashlib

import numpy as np


def generator(theme: str, seed: int, purpose: str) -> np.random.Generator:
    """The generator of one purpose ('network', 'stock', ...) in the world (theme, seed); equal in every process."""
    digest = hashlib.sha256(f"{theme}/{seed}/{purpose}".encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype="<u4"))
