"""The colours for colour-blind people can be told apart by them."""

import numpy as np
import pytest

from omniocc.classes import WORLD_CLASSES, ClassTable, SemanticClass
from omniocc.extras.viewer.page.colors import SAFE, SAFE_KINDS, class_colors, kind_colors

SEEN_BY = {
    "normal": np.eye(3),
    "protanopes": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopes": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopes": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as they see it: Machado, Oliveira and Fernandes (2009), severity 1.0."""
XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]


def lab(rgb: np.ndarray, seen_by: str) -> np.ndarray:
    """Return CIELAB (D65) of sRGB colours."""
    parts = np.asarray(rgb, float) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.array(SEEN_BY[seen_by]).T, 0, 1) @ np.array(XYZ).T / [0.95047, 1, 1.08883]
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1)


def smallest_difference(rgb: np.ndarray, seen_by: str) -> float:
    values = lab(rgb, seen_by)
    distance = np.linalg.norm(values[:, None] - values, axis=-1)
    return float(distance[np.triu_indices(len(values), 1)].min())


@pytest.mark.parametrize("seen_by", SEEN_BY)
def test_colours_differ_as_much_as_stated(seen_by):
    assert smallest_difference(SAFE[:11], seen_by) >= 26
    assert smallest_difference(SAFE, seen_by) >= 17
    assert smallest_difference([*SAFE_KINDS.values()], seen_by) >= 40


def test_the_colours_of_the_classes_are_not_safe():
    """Otherwise the second scheme would not be needed."""
    assert smallest_difference([row.rgb for row in WORLD_CLASSES.rows[1:]], "deuteranopes") < 6


def test_every_class_has_both_colours():
    names = ["free", *(f"class {k}" for k in range(1, 30))]
    table = ClassTable(tuple(SemanticClass(k, name, (k, 2 * k, 3 * k)) for k, name in enumerate(names)))
    rows = class_colors(table)
    assert [row["name"] for row in rows] == names
    assert [row["safe"] for row in rows[1 : len(SAFE) + 1]] == list(SAFE)
    assert rows[-1]["safe"] == rows[-1]["rgb"] == (29, 58, 87)
    assert [kind["name"] for kind in kind_colors()] == ["", "right", "wrong class", "missed", "hallucinated"]
