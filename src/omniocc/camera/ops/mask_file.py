"""Reading of camera masks from image files."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from omniocc.camera.protocol import Camera


def read_mask_pixels(name: str, file: Path, camera: Camera) -> UInt8[np.ndarray, "height width"]:
    """Return the grey values of a mask; raise ValueError, with `name`, if unreadable or not of the image's size."""
    pixels = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise ValueError(f"{name} {file} is not a readable image")
    if pixels.shape != (camera.height, camera.width):
        size = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise ValueError(f"{name} {file} is {size} px but the image is {camera.width}x{camera.height} px")
    return pixels.astype(np.uint8, copy=False)
