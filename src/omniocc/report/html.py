"""Web pages from the templates beside this file, and images inside them, so that a page needs no other file."""

import base64
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from omniocc.draw.canvas import PNG_OPTIONS, encoded
from omniocc.runs.table import number, text_columns

ENVIRONMENT = Environment(
    loader=PackageLoader("omniocc.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
ENVIRONMENT.filters |= {"number": number, "text_columns": text_columns}
ENVIRONMENT.policies["json.dumps_kwargs"] = {"separators": (",", ":")}  # keeps the order of keys


def render(name: str, content: dict[str, Any]) -> str:
    """Return the page of a template, whose names get the values of `content`, escaped unless they are marked as safe.

    Raises:
        jinja2.UndefinedError: when the template uses a name that is missing.
    """
    return ENVIRONMENT.get_template(name).render(content)


def webp(image: np.ndarray, quality: int) -> str:
    """Return an RGB image as a data URL in WebP; quality 1 to 100."""
    return _data_url("webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])


def png(image: np.ndarray) -> str:
    """Return an RGB image as a data URL in PNG, without loss."""
    return _data_url("png", image, PNG_OPTIONS)


def _data_url(kind: str, image: np.ndarray, options: list[int]) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(encoded(image, kind, options)).decode()}"
