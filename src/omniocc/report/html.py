"""Render web pages from the templates beside this file, with images inside, so that a page needs no other file."""

import base64
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from omniocc.draw.canvas import PNG_OPTIONS, encode_image
from omniocc.runs.table import number, text_columns

ENVIRONMENT = Environment(
    loader=PackageLoader("omniocc.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
ENVIRONMENT.filters |= {"number": number, "text_columns": text_columns}
ENVIRONMENT.policies["json.dumps_kwargs"] = {"separators": (",", ":")}  # replaces the default, which sorts keys


def render(name: str, content: dict[str, Any]) -> str:
    """Return the page that a template makes of `content`; values are escaped unless they are marked as safe.

    Args:
        name: file of the template, such as `page.html.j2`.
        content: values by the names that the template uses.

    Raises:
        jinja2.UndefinedError: when the template uses a name that `content` lacks.
    """
    return ENVIRONMENT.get_template(name).render(content)


def webp(image: np.ndarray, quality: int) -> str:
    """Return an RGB image as a data URL in WebP; `quality` is 1 to 100, from the smallest file to the best image."""
    return _data_url("webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])


def png(image: np.ndarray) -> str:
    """Return an RGB image as a data URL in PNG, which keeps every pixel."""
    return _data_url("png", image, PNG_OPTIONS)


def _data_url(kind: str, image: np.ndarray, options: list[int]) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(encode_image(image, kind, options)).decode()}"
