"""Raw data of CARLA's sensors (https://carla.readthedocs.io/en/0.9.16/ref_sensors/) as arrays."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt32

from omniocc.extras.unreal import right_handed_points

FAR_M = 1000.0
"""Distance that CARLA's depth encoding ends at; nothing but the sky is there."""
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
"""One point of the semantic LiDAR, 24 bytes; x, y, z in the sensor's Unreal frame."""


def read_bgra(raw: bytes, height: int, width: int) -> UInt8[np.ndarray, "height width 4"]:
    """Return the pixels of a camera: blue, green, red, alpha; raise ValueError if there are fewer or more bytes."""
    if len(raw) != height * width * 4:
        raise ValueError(f"an image of {width}x{height} px has {len(raw)} bytes instead of {height * width * 4}")
    return np.frombuffer(raw, np.uint8).reshape(height, width, 4)


def rgb_of(pixels: UInt8[np.ndarray, "height width 4"]) -> UInt8[np.ndarray, "height width 3"]:
    """Return the colours."""
    return np.ascontiguousarray(pixels[..., 2::-1])


def tags_in(pixels: UInt8[np.ndarray, "height width 4"]) -> UInt8[np.ndarray, "height width"]:
    """Return the semantic tags: the red channel."""
    return np.ascontiguousarray(pixels[..., 2])


def inverse_depth_of(pixels: UInt8[np.ndarray, "height width 4"]) -> Float32[np.ndarray, "height width"]:
    """Return inverse distances along the optical axis, 1/m; 0 for the sky.

    The distance is 1000 (R + 256 G + 65536 B) / (2^24 - 1) m: planar, not along the ray.
    """
    blue, green, red = (pixels[..., channel].astype(np.float64) for channel in range(3))
    depth_m = FAR_M * (red + 256 * green + 65536 * blue) / (2**24 - 1)
    sky = depth_m > FAR_M * (1 - 1e-6)
    return np.where(sky, 0, 1 / np.maximum(depth_m, 1e-3)).astype(np.float32)


class Scan(NamedTuple):
    """Points of a semantic LiDAR.

    Attributes:
        points_m: (P, 3) in the right-handed frame of the sensor.
        actors: (P,) that were hit, by number; 0 for none.
        labels: (P,) our classes of their tags.
    """

    points_m: Float64[np.ndarray, "P 3"]
    actors: UInt32[np.ndarray, " P"]
    labels: UInt8[np.ndarray, " P"]


def read_scan(raw: bytes, classes: UInt8[np.ndarray, " 256"], own_actor: int) -> Scan:
    """Return the points of a semantic LiDAR without those of its own vehicle; raise ValueError if one is cut off."""
    found = read_points(raw)
    found = found[found["actor"] != own_actor]
    points_m = np.stack([found[axis] for axis in "xyz"], axis=1).astype(np.float64)
    return Scan(right_handed_points(points_m), found["actor"], classes[np.minimum(found["tag"], 255)])


def read_points(raw: bytes) -> np.ndarray:
    """Return the points of a semantic LiDAR, (P,) of `POINT`; raise ValueError if a point is cut off."""
    if len(raw) % POINT.itemsize:
        raise ValueError(f"a scan has {len(raw)} bytes, which is no multiple of {POINT.itemsize}")
    return np.frombuffer(raw, POINT)
