"""Checks of what users hand to a metric."""

import torch
from torch import Tensor


def check_labels(
    name: str, labels: Tensor, shape: tuple[int, ...], num_classes: int, ignore_class: int | None = None
) -> Tensor:
    """Checks class ids and returns them as uint8.

    Args:
        name: how messages call the tensor.
        labels: (B, *shape) of an integer type.
        shape: what must follow the batch axis.
        num_classes: ids must lie in 0 .. num_classes-1 ...
        ignore_class: ... or be this one.

    Raises:
        ValueError: naming shape, type or value.
    """
    if labels.is_floating_point() or labels.is_complex() or labels.dtype == torch.bool:
        raise ValueError(f"{name} must hold class ids in an integer type, got {labels.dtype}; take logits.argmax(1)")
    if labels.ndim != len(shape) + 1 or labels.shape[1:] != shape:
        expected = ", ".join(["B", *map(str, shape)])
        raise ValueError(f"{name} must have shape ({expected}), got {tuple(labels.shape)}")
    wrong = (labels < 0) | (labels >= num_classes)
    if ignore_class is not None:
        wrong &= labels != ignore_class
    if wrong.any():
        allowed = f"0..{num_classes - 1}" + ("" if ignore_class is None else f" or {ignore_class}")
        raise ValueError(f"{name} must hold class ids {allowed}, got {labels[wrong].unique().tolist()[:8]}")
    return labels.to(torch.uint8)


def check_same_batch(first: str, left: Tensor, second: str, right: Tensor) -> None:
    """Raises a ValueError unless both tensors have the same batch size."""
    if len(left) != len(right):
        raise ValueError(f"{first} and {second} must have the same batch size, got {len(left)} and {len(right)}")
