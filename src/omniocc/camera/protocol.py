"""The methods that every camera model has, and checks of camera parameters."""

import re
import sys
from collections.abc import Callable, Mapping
from typing import Protocol, TypeGuard, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.errors import repr_of

EXPONENTIAL = re.compile(r"[-+]?[0-9]{1,20}e[-+]?[0-9]{1,3}", re.IGNORECASE)


@runtime_checkable
class Camera(Protocol):
    """A camera model, which maps points in the camera frame (x right, y down, z forward; m) to pixels and back.

    Every model is a frozen dataclass. Rays have unit length. They are never computed on the plane z = 1, so that angles
    past 90 degrees are as exact as smaller ones. Results that are not valid are finite too, without NaN in gradients.
    Tensors may be float32 or float64, on any device.
    """

    @property
    def width(self) -> int:
        """Return the width of the image, px."""
        ...

    @property
    def height(self) -> int:
        """Return the height of the image, px."""
        ...

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """Return the pixel (u, v) of each point, and whether the model covers its angle and it is in the image."""
        ...

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """Return the unit ray of each pixel, in the image or not, and whether the model covers the angle of the ray."""
        ...

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera after its image is scaled to another size, px."""
        ...


def is_finite(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a finite number; a truth value is none."""
    # the bound also excludes nan, and whole numbers that are too large for a float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def finite(name: str, value: object) -> float:
    """Return `value` as a float; raise ValueError unless it is a finite number, or a text like 1e-05.

    YAML 1.1 takes such a number for a text, and Python prints small numbers so.
    """
    if isinstance(value, str) and EXPONENTIAL.fullmatch(value):
        value = float(value)
    if not is_finite(value):
        raise ValueError(f"{name} is {repr_of(value)}; it must be a finite number")
    return float(value)


def positive(name: str, value: object) -> float:
    """Return `value` as a float; raise ValueError unless it is finite and above zero."""
    number = finite(name, value)
    if number <= 0:
        raise ValueError(f"{name} is {repr_of(value)}; it must be above 0")
    return number


def pair(name: str, value: object) -> tuple[float, float]:
    """Return `value` as a tuple of two floats; raise ValueError unless it is a list of two finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{name} is {repr_of(value)}; it must be two numbers")
    return finite(name, value[0]), finite(name, value[1])


def positive_pair(name: str, value: object) -> tuple[float, float]:
    """Return `value` as a tuple of two floats; raise ValueError unless both are finite and above zero."""
    first, second = pair(name, value)
    return positive(name, first), positive(name, second)


def numbers(name: str, value: object, least: int, most: int) -> tuple[float, ...]:
    """Return `value` as a tuple of floats; raise ValueError unless it is a list of `least` to `most` finite numbers."""
    count = str(least) if least == most else f"{least} to {most}"
    if not isinstance(value, list | tuple) or not least <= len(value) <= most:
        raise ValueError(f"{name} is {repr_of(value)}; it must be {count} numbers")
    return tuple(finite(name, number) for number in value)


def angle_from_axis(name: str, value: object) -> float:
    """Return `value` as a float; raise ValueError unless it is above 0 and at most 180 degrees."""
    angle_deg = positive(name, value)
    if angle_deg > 180:
        raise ValueError(f"{name} is {repr_of(value)}; it is measured from the axis and ends at 180")
    return angle_deg


def four_numbers(name: str, value: object) -> tuple[float, ...]:
    """Return `value` as a tuple of floats; raise ValueError unless it is a list of four finite numbers."""
    return numbers(name, value, 4, 4)


def check_fields(camera: Camera, checks: Mapping[str, Callable[[str, object], object]]) -> None:
    """Check the image size of a camera, and replace each field in `checks` by its checked value.

    Args:
        camera: a frozen dataclass, whose fields are changed; called while it is made (`__post_init__`).
        checks: by name of a field: `check(name, value)`, which returns the checked value or raises ValueError.

    Raises:
        ValueError: when a field is wrong, or width or height is no positive whole number; the message names it.
    """
    for name, value in (("width", camera.width), ("height", camera.height)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ValueError(f"{name} is {repr_of(value)}; it must be a positive whole number of pixels")
    for name, check in checks.items():
        object.__setattr__(camera, name, check(name, getattr(camera, name)))


def scaled_center(center_px: tuple[float, float], scale_x: float, scale_y: float) -> tuple[float, float]:
    """Return the principal point of a scaled image, px; the image's corner (-0.5, -0.5) is the fixed point."""
    return (center_px[0] + 0.5) * scale_x - 0.5, (center_px[1] + 0.5) * scale_y - 0.5
