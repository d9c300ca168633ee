"""Polynomials of lens models: their values, the interval on which they increase, and the inverse on it.

Coefficients ascend: c[0] + c[1] x + c[2] x^2 + ...
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

MAX_COEFFICIENTS = 40
"""Most coefficients of a polynomial that is read from a file."""
NODES = 1024
STEPS = 8  # measured: 4 suffice to reach rounding error, except near a turning point

Function = Callable[[Tensor], Tensor]


def evaluate(coefficients: tuple[float, ...], x: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return the polynomial at x, by Horner's rule."""
    result = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        result = result * x + coefficient
    return result


def derivative(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the coefficients of the derivative."""
    return tuple(power * value for power, value in enumerate(coefficients))[1:] or (0.0,)


@lru_cache(maxsize=256)
def positive_until(coefficients: tuple[float, ...], start: float, stop: float) -> float:
    """Return the first x in [start, stop] where the polynomial stops being positive; `stop` if it never does."""
    if np.polynomial.polynomial.polyval(start, coefficients) <= 0:
        return start
    trimmed = np.trim_zeros(np.asarray(coefficients, dtype=np.float64), "b")
    roots = np.roots(trimmed[::-1])
    # Rounding can give a double root an imaginary part above this tolerance (7e-9 measured): it is then not counted.
    real = roots.real[np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots.real))]
    inside = real[(real > start) & (real < stop)]
    return float(inside.min()) if inside.size else stop


def invert_increasing(
    function: Function, slope: Function, values: Float[Tensor, "*batch"], start: float, stop: float
) -> Float[Tensor, "*batch"]:
    """Return x in [start, stop] with function(x) = values, for a function that increases in this interval.

    A table brackets the root, safeguarded Newton steps find it to rounding, and a last step outside `no_grad` carries
    the gradient of the inverse. Values beyond the ends give the ends.

    Raises:
        ValueError: if `stop` is not finite.
    """
    if not math.isfinite(stop):
        raise ValueError(f"cannot search for a root up to {stop}")
    nodes = torch.linspace(start, stop, NODES, dtype=values.dtype, device=values.device)
    with torch.no_grad():
        table = function(nodes).cummax(0).values
    targets = values.clamp(table[0].item(), table[-1].item())
    with torch.no_grad():
        x = _search(function, slope, targets, nodes, table)
        # at a turning point the slope is 0, and the gradient of the inverse infinite
        steepness = slope(x).clamp(min=torch.finfo(values.dtype).eps ** 0.5)
        error = function(x)
    return (x - (error - targets) / steepness).clamp(start, stop)


def invert_polynomial(
    coefficients: tuple[float, ...], values: Float[Tensor, "*batch"], stop: float
) -> Float[Tensor, "*batch"]:
    """Return x in [0, stop] where a polynomial that increases there has these values; see `invert_increasing`."""
    slope = derivative(coefficients)
    return invert_increasing(lambda x: evaluate(coefficients, x), lambda x: evaluate(slope, x), values, 0.0, stop)


def _search(function: Function, slope: Function, targets: Tensor, nodes: Tensor, table: Tensor) -> Tensor:
    cell = (torch.searchsorted(table, targets.detach().contiguous()) - 1).clamp(0, len(nodes) - 2)
    low, high, bottom, top = nodes[cell], nodes[cell + 1], table[cell], table[cell + 1]
    fraction = (targets - bottom) / (top - bottom).clamp(min=torch.finfo(table.dtype).tiny)
    x = low + (high - low) * fraction.clamp(0, 1)
    for _ in range(STEPS):
        error = function(x) - targets
        low, high = torch.where(error < 0, x, low), torch.where(error > 0, x, high)
        newton = x - error / slope(x)
        x = torch.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
    return x
