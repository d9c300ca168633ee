"""Checks of what users hand to a metric."""

import itertools

import torch
from torch import Tensor


def check_labels(
    name: str, labels: Tensor, shape: tuple[int, ...], num_classes: int, ignore_class: int | None = None
) -> Tensor:
    """Checks class ids and returns them as uint8.

    Args:
        name: how messages call the tensor.
        labels: (B, *shape) of an integer type, or whole numbers of a floating one.
        shape: what must follow the batch axis.
        num_classes: ids must lie in 0 .. num_classes-1 ...
        ignore_class: ... or be this one.

    Raises:
        ValueError: naming shape, type or value.
    """
    if labels.ndim != len(shape) + 1 or labels.shape[1:] != shape:
        expected = ", ".join(["B", *map(str, shape)])
        hint = "; take logits.argmax(1)" if labels.ndim == len(shape) + 2 else ""
        raise ValueError(f"{name} must have shape ({expected}), got {tuple(labels.shape)}{hint}")
    if labels.is_complex() or labels.dtype == torch.bool:
        raise ValueError(f"{name} must hold class ids in an integer type, got {labels.dtype}")
    whole = not labels.is_floating_point() or bool((labels == labels.floor()).all())
    if labels.numel() and not (whole and labels.amin() >= 0 and labels.amax() < num_classes):
        _check_each(name, labels, num_classes, ignore_class)
    return labels.to(torch.uint8)


def _check_each(name: str, labels: Tensor, num_classes: int, ignore_class: int | None) -> None:
    wrong = (labels < 0) | (labels >= num_classes) | (labels != labels.floor())
    if ignore_class is not None:
        wrong &= labels != ignore_class
    if wrong.any():
        allowed = f"0..{num_classes - 1}" + ("" if ignore_class is None else f" or {ignore_class}")
        found = labels[wrong].unique().tolist()[:8]
        raise ValueError(f"{name} must hold class ids {allowed}, got {found} in {labels.dtype}")


def check_mask(name: str, mask: Tensor | None, shape: torch.Size) -> None:
    """Raises a ValueError unless the mask is bool and has this shape."""
    if mask is not None and (mask.shape != shape or mask.dtype != torch.bool):
        raise ValueError(f"{name} must be bool of shape {tuple(shape)}, got {mask.dtype} of shape {tuple(mask.shape)}")


def check_same_batch(first: str, left: Tensor, second: str, right: Tensor) -> None:
    """Raises a ValueError unless both tensors have the same batch size."""
    if len(left) != len(right):
        raise ValueError(f"{first} and {second} must have the same batch size, got {len(left)} and {len(right)}")


def check_increasing(name: str, values: tuple[float, ...], at_least: int) -> None:
    """Raises a ValueError unless there are so many distances in metres, each above the one before."""
    rising = all(low < high for low, high in itertools.pairwise(values))
    if len(values) < at_least or not rising or (values and values[0] < 0):
        raise ValueError(f"{name} must be {at_least} or more increasing distances in metres, got {values}")


def check_classes(num_classes: int, free_class: int, ignore_class: int) -> None:
    """Raises a ValueError unless the ids fit into uint8 and the ignored one is no class."""
    if not 2 <= num_classes <= 255:
        raise ValueError(f"num_classes must be 2..255, got {num_classes}")
    if not 0 <= free_class < num_classes:
        raise ValueError(f"free_class must be 0..{num_classes - 1}, got {free_class}")
    if not num_classes <= ignore_class <= 255:
        raise ValueError(f"ignore_class must be {num_classes}..255, beyond the classes, got {ignore_class}")
