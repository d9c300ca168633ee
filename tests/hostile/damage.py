"""Damage what parses: every key of a tree, every array of a file, each with every value that cannot be."""

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

IMPOSSIBLE: dict[str, Any] = {
    "null": None,
    "a-text": "left",
    "an-empty-text": "",
    "a-truth": True,
    "nothing": 0,
    "negative": -1,
    "a-fraction": 0.5,
    "nan": float("nan"),
    "infinite": float("inf"),
    "huge": 10**12,
    "beyond-float": 10**400,
    "an-empty-list": [],
    "a-list-of-null": [None],
    "a-list-of-nan": [float("nan")] * 3,
    "ragged": [[0.0], [0.0, 1.0]],
    "an-empty-mapping": {},
    "a-mapping": {"a": None},
}
"""Values that stand in place of others; some of them are possible for some keys."""
MOST_KEYS = 3
"""Entries of a long mapping that are damaged; the others are like them."""
Tree = Any


def places(tree: Tree, most: int = MOST_KEYS) -> Iterator[tuple[Any, ...]]:
    """Yield the place of every value in a tree of plain data: of lists the first one, of long mappings some."""
    keys = [0] if isinstance(tree, list) and tree else list(tree) if isinstance(tree, dict) else []
    for key in keys if len(keys) <= 4 * most else keys[:most]:
        yield (key,)
        yield from ((key, *rest) for rest in places(tree[key], most))


def damaged_trees(tree: Tree) -> Iterator[tuple[str, Tree]]:
    """Yield copies of a tree with one value removed or replaced, and what was done to each."""
    for place in places(tree):
        *way, last = place
        for name in ("removed", *IMPOSSIBLE):
            found = copy.deepcopy(tree)
            inner = found
            for key in way:
                inner = inner[key]
            if name == "removed":
                del inner[last]
            else:
                inner[last] = copy.deepcopy(IMPOSSIBLE[name])
            yield f"{'.'.join(map(str, place))}-{name}", found
    for name, value in IMPOSSIBLE.items():
        yield f"all-{name}", copy.deepcopy(value)


ARRAYS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "empty": lambda array: array[:0],
    "half": lambda array: array[: len(array) // 2],
    "flat": lambda array: array.reshape(-1),
    "a-number": lambda array: array.reshape(-1)[0],
    "more-dimensions": lambda array: array[None],
    "transposed": lambda array: array.T,
    "texts": lambda array: np.full(array.shape, "left"),
    "objects": lambda array: np.full(array.shape, None, object),
    "truths": lambda array: np.ones(array.shape, bool),
    "complex": lambda array: array.astype(np.complex64),
    "records": lambda array: np.zeros(array.shape, [("a", "<f4")]),
    "times": lambda array: np.zeros(array.shape, "datetime64[s]"),
    "float64": lambda array: array.astype(np.float64),
    "float16": lambda array: array.astype(np.float16),
    "int64": lambda array: array.astype(np.int64),
    "bytes": lambda array: array.astype(np.uint8),
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "nan": lambda array: np.full(array.shape, np.nan),
    "infinite": lambda array: np.full(array.shape, np.inf),
    "huge": lambda array: np.full(array.shape, 1e30),
    "huge-whole": lambda array: np.full(array.shape, 2**62),
    "negative": lambda array: np.full(array.shape, -1),
}
"""Arrays in place of others."""
BYTES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "half": lambda content: content[: len(content) // 2],
    "a-byte-less": lambda content: content[:-1],
    "a-byte-more": lambda content: content + b"\x07",
    "twice": lambda content: content + content,
    "zeros": lambda content: bytes(len(content)),
    "ones": lambda content: b"\xff" * len(content),
    "a-text": lambda content: b"left",
    "turned-round": lambda content: content[::-1],
}
"""Bytes in place of others."""


def dumped(tree: Tree) -> bytes:
    """Return a tree as JSON; nan and infinity as Python writes them."""
    return json.dumps(tree).encode()
