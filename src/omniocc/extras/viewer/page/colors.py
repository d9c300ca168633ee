"""Colours that colour-blind people can tell apart.

They were chosen one after the other, each as far as possible from those before: the smallest CIELAB distance between
two of them, as people with normal sight, protanopes, deuteranopes and tritanopes see them (Machado, Oliveira and
Fernandes: A Physiologically-based Model for Simulation of Color Vision Deficiency, 2009), is at least 26 among the
first eleven and 17 among all.
"""

from omniocc.classes import FREE, ClassTable
from omniocc.draw.bev import ERRORS
from omniocc.draw.canvas import Rgb

SAFE: tuple[Rgb, ...] = (
    (120, 120, 135),
    (240, 210, 255),
    (180, 135, 90),
    (45, 60, 90),
    (105, 30, 150),
    (105, 255, 180),
    (255, 120, 15),
    (75, 150, 210),
    (105, 45, 0),
    (195, 30, 255),
    (180, 255, 120),
    (150, 180, 165),
    (210, 60, 0),
    (0, 0, 240),
    (255, 210, 0),
    (165, 60, 75),
    (75, 105, 150),
    (255, 15, 195),
    (90, 0, 180),
    (120, 225, 120),
)
"""By class from 1 on; the first eleven are in the order of the virtual world's classes."""
SAFE_KINDS: dict[str, Rgb] = {
    "right": (214, 219, 224),
    "wrong class": (255, 180, 0),
    "missed": (0, 90, 200),
    "hallucinated": (150, 30, 30),
}
"""By kind of difference, in the order in which the page numbers them from 1 on."""


def class_colors(classes: ClassTable) -> list[dict]:
    """Return name, colour and colour-blind-safe colour of every class; classes beyond `SAFE` keep their colour."""
    safe = {label: SAFE[label - 1] for label in range(1, min(len(SAFE) + 1, classes.num_classes))}
    rows = [{"name": row.name, "rgb": row.rgb, "safe": safe.get(row.id, row.rgb)} for row in classes.rows]
    assert rows[FREE]["safe"] == rows[FREE]["rgb"]
    return rows


def kind_colors() -> list[dict]:
    """Return the same for the kinds of differences; the first entry stands for 'none'."""
    colors = dict(ERRORS)
    kinds = [{"name": name, "rgb": colors[name], "safe": safe} for name, safe in SAFE_KINDS.items()]
    return [{"name": "", "rgb": (0, 0, 0), "safe": (0, 0, 0)}, *kinds]
