"""Degrade images by exposure, noise, blur or JPEG. Images are (H, W, 3) uint8 RGB."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import UInt8

from omniocc.errors import DataError

Image = UInt8[np.ndarray, "H W 3"]


def change_exposure(image: Image, stops: float) -> Image:
    """Return an image exposed to 2**stops times as much light; what would be brighter than white is white.

    Pixel values are taken as light encoded by the curve of sRGB (IEC 61966-2-1).
    """
    return exposure_table(stops)[image]


@lru_cache(maxsize=8)
def exposure_table(stops: float) -> UInt8[np.ndarray, "256"]:
    """Return the pixel value that replaces each of the 256 values when the exposure changes by `stops`."""
    value = np.arange(256) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    gained = np.minimum(linear * 2.0**stops, 1)
    encoded = np.where(gained <= 0.0031308, 12.92 * gained, 1.055 * gained ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def add_noise(image: Image, percent: float, rng: np.random.Generator) -> Image:
    """Return an image plus Gaussian noise in every channel; its standard deviation is `percent` of white (255)."""
    noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(2.55 * percent)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def blur(image: Image, sigma_px: float) -> Image:
    """Return an image blurred by a Gaussian; pixels beyond the border have the value of the nearest one in it."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE))


def compress_jpeg(image: Image, quality: int) -> Image:
    """Return an image as decoded after JPEG compression with a quality of 1 to 100.

    Raises:
        DataError: when OpenCV cannot encode it.
    """
    # OpenCV takes and returns BGR
    done, file = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise DataError(f"an image of {image.shape} cannot be encoded as JPEG of quality {quality}")
    return np.ascontiguousarray(np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR))[..., ::-1])
