"""Checks of the arguments of metrics."""

import hashlib
import itertools
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.labels import MOST_SHOWN

Array = Any
"""What metrics take as inputs: a tensor, an array of numpy, or nested lists of numbers."""
NO_ORDER = (torch.uint16, torch.uint32, torch.uint64)
"""Types in which torch does not compare."""


def as_tensors(device: torch.device | str, **values: Any) -> tuple[Any, ...]:
    """Return tensors of arrays, by name: tensors and None as they are, numpy arrays and lists copied to the device.

    Raises:
        ValueError: with the name, for what is no array of numbers.
    """
    return tuple(
        value if value is None or isinstance(value, Tensor) else _as_tensor(name, value).to(device)
        for name, value in values.items()
    )


def _as_tensor(name: str, value: object) -> Tensor:
    try:
        # a copy in this machine's byte order: torch takes no other order, no backward steps and no array to read only
        array = np.asarray(value)
        return torch.from_numpy(array.astype(array.dtype.newbyteorder("="), order="C"))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be a tensor or a numpy array of numbers, got {type(value).__name__}") from error


def check_real(name: str, values: Tensor) -> None:
    """Raise ValueError with `name` for complex numbers and masks."""
    if values.is_complex() or values.dtype == torch.bool:
        raise ValueError(f"{name} must hold real numbers, got {values.dtype}")


def check_grid(name: str, grid: object) -> None:
    """Raise ValueError with `name` unless it is a grid; a shape alone does not say how large the cells are."""
    if not isinstance(grid, Cylinder | Cuboid):
        raise ValueError(
            f"{name} must be a grid, rayiou.Cuboid(shape, x_m, y_m, height_m) or "
            f"Cylinder(shape, radius_m, height_m), got {type(grid).__name__}"
        )


def check_labels(
    name: str, labels: Tensor, shape: tuple[int, ...], num_classes: int, ignore_index: int | None = None
) -> Tensor:
    """Return class ids (B, *shape), whole numbers of any type, as uint8.

    Raises:
        ValueError: with `name`, for a wrong shape, type, or id other than 0 .. num_classes-1 and `ignore_index`.
    """
    if labels.ndim != len(shape) + 1 or labels.shape[1:] != shape:
        expected = ", ".join(["B", *map(str, shape)])
        hint = "; take logits.argmax(1)" if labels.ndim == len(shape) + 2 else ""
        raise ValueError(f"{name} must have shape ({expected}), got {tuple(labels.shape)}{hint}")
    if labels.is_complex() or labels.dtype == torch.bool:
        raise ValueError(f"{name} must hold class ids in an integer type, got {labels.dtype}")
    labels = labels.long() if labels.dtype in NO_ORDER else labels
    whole = not labels.is_floating_point() or bool((labels == labels.floor()).all())
    if not labels.numel() or (whole and labels.amin() >= 0 and labels.amax() < num_classes):
        return labels.to(torch.uint8)
    wrong = (labels < 0) | (labels >= num_classes) | (labels != labels.floor())
    if ignore_index is not None:
        wrong &= labels != ignore_index
    if wrong.any():
        allowed = f"0..{num_classes - 1}" + ("" if ignore_index is None else f" or {ignore_index}")
        found = labels[wrong].unique().tolist()[:MOST_SHOWN]
        raise ValueError(f"{name} must hold class ids {allowed}, got {found} in {labels.dtype}")
    return labels.to(torch.uint8)


def check_mask(name: str, mask: Tensor | None, shape: torch.Size) -> None:
    """Raise ValueError unless the mask is None, or bool of this shape."""
    if mask is not None and (mask.shape != shape or mask.dtype != torch.bool):
        raise ValueError(f"{name} must be bool of shape {tuple(shape)}, got {mask.dtype} of shape {tuple(mask.shape)}")


def check_origins(name: str, origins_m: Tensor) -> None:
    """Raise ValueError with `name` unless all starts of rays (..., 3) are finite: other rays would just hit nothing."""
    starts = origins_m.reshape(-1, 3)
    wrong = starts[~starts.isfinite().all(dim=1)]
    if len(wrong):
        raise ValueError(f"{name} must be finite, got {wrong[0].tolist()} among {len(wrong)} that are not")


def check_same_shape(first: str, left: Tensor, second: str, right: Tensor) -> None:
    """Raise ValueError unless both tensors have the same shape."""
    if left.shape != right.shape:
        shapes = f"{tuple(left.shape)} and {tuple(right.shape)}"
        raise ValueError(f"{first} and {second} must have the same shape, got {shapes}")


def check_same_batch(first: str, left: Tensor, second: str, right: Tensor) -> None:
    """Raise ValueError unless both tensors have the same batch size."""
    if len(left) != len(right):
        raise ValueError(f"{first} and {second} must have the same batch size, got {len(left)} and {len(right)}")


def check_increasing(name: str, values: tuple[float, ...], at_least: int) -> None:
    """Raise ValueError unless `values` are `at_least` distances in metres, increasing and none negative."""
    rising = all(low < high for low, high in itertools.pairwise(values))
    if len(values) < at_least or not rising or (values and values[0] < 0):
        raise ValueError(f"{name} must be {at_least} or more increasing distances in metres, got {values}")


def hash_of(content: bytes) -> UInt8[Tensor, "16"]:
    """Return a hash of all that decides what is counted."""
    return torch.tensor(list(hashlib.sha256(content).digest()[:16]), dtype=torch.uint8)
