"""Counts the operations that the simulated second device is given: by slot, by line, and those that wait for it.

Composite operations are counted as their parts, with and without gradient alike. Not counted are constants that
PyTorch itself fills, such as the 0 of `torch.where(mask, x, 0)`.
"""

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import torch
from second_device import tagged
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

SOURCES = str(Path(__file__).parents[1] / "src")
SLOTS = {
    "model/depth/": "depth",
    "model/sketch/": "sketch",
    "model/backbone/": "backbone",
    "model/lifter/": "lifter",
    "model/temporal/": "temporal",
    "model/refiner/": "refiner",
    "model/semantic_head/": "2D head",
    "model/hints/": "hints",
    "omniocc/loss/": "loss",
    "data/augment/": "augmentation",
    "train/muon.py": "optimizer",
    "torch/optim/": "optimizer",
    "clip_grad": "clipping",
    "logger_connector": "logging",
    "autograd/graph.py": "backward",
    "model/ops/depth/": "depth",
    "model/ops/sketch.py": "sketch",
    "model/occupancy.py": "classifier",
}
"""Parts of a source file's name and its slot; the innermost such file in the stack counts."""
OTHERS = "others"
EMPTY = {"empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided"}
NO_KERNEL = EMPTY | {"lift_fresh", "set_", "_unsafe_view", "is_same_size"}
"""Operations that compute nothing although they return no view."""
WAITING = {"_local_scalar_dense", "nonzero", "masked_select", "bincount", "equal", "_unique2", "unique_dim", "histc"}
"""Operations of which the processor waits for the result, or for its size."""
MASKED = {"index", "index_put", "index_put_", "_index_put_impl_"}
"""Operations that wait if an index is a mask."""
COMPOSITE = torch._C.DispatchKey.CompositeImplicitAutograd


def starts_kernel(func: Any) -> bool:
    """Return whether an operation computes on the device: it returns no view and no empty tensor."""
    return not (func.is_view or func.overloadpacket.__name__ in NO_KERNEL)


def waits(func: Any, args: Any) -> bool:
    """Return whether the processor waits for the device: it reads a value, or the size of a result."""
    name = func.overloadpacket.__name__
    if name in MASKED:
        indices = [leaf for leaf in tree_leaves(args[1]) if isinstance(leaf, torch.Tensor)]
        return any(index.dtype in (torch.bool, torch.uint8) for index in indices)
    return name in WAITING or (name == "repeat_interleave" and func._overloadname == "Tensor")


def place() -> tuple[str, str]:
    """Return the slot of the running code, and its innermost line of `src`."""
    frame, slot, line = sys._getframe(2), "", ""
    while frame is not None and not (slot and line):
        name = frame.f_code.co_filename
        if not line and name.startswith(SOURCES):
            line = f"{name[len(SOURCES) + 1 :]}:{frame.f_lineno}"
        slot = slot or next((value for part, value in SLOTS.items() if part in name), "")
        frame = frame.f_back
    return slot or OTHERS, line


class Operations(TorchDispatchMode):
    """Counts operations that have or return a tensor of the second device.

    Attributes:
        total: all of them, by slot.
        kernels: those that compute something.
        waits: those for which the processor waits.
        lines: those that compute something, by slot, line of `src` and name.
        waiting_lines: the same of those for which the processor waits.
    """

    def __init__(self) -> None:
        super().__init__()
        self.total: Counter[str] = Counter()
        self.kernels: Counter[str] = Counter()
        self.waits: Counter[str] = Counter()
        self.lines: Counter[tuple[str, str, str]] = Counter()
        self.waiting_lines: Counter[tuple[str, str, str]] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation, counted."""
        kwargs = kwargs or {}
        if torch._C._dispatch_has_kernel_for_dispatch_key(func.name(), COMPOSITE):
            with self:
                return func._op_dk(COMPOSITE, *args, **kwargs)
        result = func(*args, **kwargs)
        if any(tagged(leaf) for leaf in tree_leaves((args, kwargs, result)) if isinstance(leaf, torch.Tensor)):
            slot, line = place()
            here = slot, line, func.overloadpacket.__name__
            self.total[slot] += 1
            if starts_kernel(func):
                self.kernels[slot] += 1
                self.lines[here] += 1
            if waits(func, args):
                self.waits[slot] += 1
                self.waiting_lines[here] += 1
        return result
