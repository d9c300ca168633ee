"""Write the page: one HTML file with its data and its code, which loads nothing else."""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from omniocc.errors import UserError
from omniocc.extras.viewer.frames import Shown, ShownFrame
from omniocc.extras.viewer.page.pack import IMAGE_PX, Packed, pack
from omniocc.io import atomic_write
from omniocc.runs.folder import PAGE

ENVIRONMENT = Environment(
    loader=PackageLoader("omniocc.extras.viewer.page", "static"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
THREE = "vendor/three.min.js"
START = 'import "omniocc/main.js";'


def page_path(output: str | None, runs: Sequence[str]) -> Path:
    """Return the file of a page: `output`, else in the folder of the only run, else in the working folder."""
    if output is not None:
        return Path(output)
    return Path(runs[0], PAGE) if len(runs) == 1 and Path(runs[0]).is_dir() else Path(PAGE)


def write_page(shown: Shown, frames: Iterable[ShownFrame], path: Path, image_px: int = IMAGE_PX) -> None:
    """Write a page in which the frames can be turned, compared and played.

    Images that are wider than `image_px` are scaled.
    `#frame=3` at the end of its address opens the fourth frame, `#scene=test-000-oldtown&frame=12` a frame by name.

    Raises:
        UserError: when there is no frame.
        DataError: when the file cannot be written.
    """
    packed = pack(shown, frames, image_px)
    if not packed.facts["frames"]:
        raise UserError(f"{path}: there are no frames to show")
    atomic_write(path, render(packed, title_of(shown)))


def title_of(shown: Shown) -> str:
    """Return the title of a page: the runs, or that there are none."""
    return ", ".join(shown.models) or "Recorded scenes"


def render(packed: Packed, title: str) -> str:
    """Return the page as text; whatever stands in the data is inert in it."""
    style, importmap = _text("static/page.css"), json.dumps({"imports": _modules()})
    content = {
        "title": title,
        "policy": _policy([importmap, START], style),
        "style": Markup(style),
        "facts": Markup(_inert_json(packed.facts)),
        "blocks": packed.blocks.items(),
        "importmap": Markup(importmap),
        "start": Markup(START),
    }
    return ENVIRONMENT.get_template("page.html.j2").render(content)


def _policy(scripts: list[str], style: str) -> str:
    """Return the Content-Security-Policy: the page's own code, style and images, nothing from elsewhere."""
    code = " ".join(_digest(script) for script in scripts)
    parts = {
        "default-src": "'none'",
        "script-src": f"{code} data:",
        "style-src": _digest(style),
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in parts.items())


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _modules() -> dict[str, str]:
    """Return the address of each module's code by the name under which it is imported."""
    own = [entry.name for entry in files("omniocc.extras.viewer.page").joinpath("static").iterdir()]
    named = {f"omniocc/{name}": f"static/{name}" for name in sorted(own) if name.endswith(".js")}
    return {name: _data_url(_text(path)) for name, path in {"three": THREE, **named}.items()}


def _data_url(code: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(code.encode()).decode()}"


def _text(path: str) -> str:
    return files("omniocc.extras.viewer.page").joinpath(path).read_text("utf-8")


def _inert_json(data: dict[str, Any]) -> str:
    """Return JSON that cannot end the script element that it stands in."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
