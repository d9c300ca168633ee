"""Images inside a page, so that it needs no other file."""

import base64

import cv2
import numpy as np


def webp(image: np.ndarray, quality: int) -> str:
    """Return an RGB image as a data URL in WebP; quality 1 to 100."""
    return _data_url("webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])


def png(image: np.ndarray) -> str:
    """Return an RGB image as a data URL in PNG, without loss."""
    return _data_url("png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _data_url(kind: str, image: np.ndarray, options: list[int]) -> str:
    done, data = cv2.imencode(f".{kind}", cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR), options)
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
