"""Directions between the entries of a table are those of the lens models; the colour-blind can tell colours apart."""

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES, ClassTable, SemanticClass
from omniocc.extras.viewer.page.pack import (
    SAFE,
    SAFE_KINDS,
    UNIT,
    class_colors,
    direction_table,
    interpolate,
    kind_colors,
)

RIGS = ("fisheye6", "pinhole6", "surround_view")
SEEN_BY = {
    "normal": np.eye(3),
    "protanopes": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopes": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopes": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as they see it: Machado, Oliveira and Fernandes (2009), severity 1.0."""
XYZ = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]


@pytest.mark.parametrize("size", [(160, 90), (512, 288)])
@pytest.mark.parametrize("name", RIGS)
def test_every_pixel_has_the_direction_of_the_rig(name, size):
    rig = Rig.load(name).resized(*size)
    for camera in (0, len(rig.cameras) - 1):
        table = direction_table(rig, camera)
        exact, valid = (part.numpy() for part in rig.rays(camera))
        assert np.array_equal(table.valid, valid)
        v, u = np.nonzero(valid)
        found = interpolate(table.directions, table.step, u, v)
        angle = np.degrees(2 * np.arcsin(np.linalg.norm(found - exact[v, u], axis=1) / 2))
        assert angle.max() < 0.1
        assert table.directions.size < valid.size * 3 / table.step**2 * 1.5 + 1000


def test_directions_between_pixels_are_interpolated_too():
    rig = Rig.load("fisheye6").resized(160, 90)
    table = direction_table(rig, 0)
    random = np.random.default_rng(0)
    pixels = torch.from_numpy(random.uniform([40, 20], [120, 70], (200, 2)))
    rays, valid = rig.cameras[0].unproject(pixels)
    assert valid.all()
    exact = (rays @ rig.ego_from_camera[0, :3, :3].T).numpy()
    found = interpolate(table.directions, table.step, *pixels.numpy().T)
    assert np.degrees(np.linalg.norm(found - exact, axis=1)).max() < 0.1


def test_a_table_holds_unit_directions_in_the_ego_frame():
    rig = Rig.load("pinhole6").resized(64, 36)
    table = direction_table(rig, 0)
    assert np.abs(np.linalg.norm(table.directions.astype(float), axis=-1) / UNIT - 1).max() < 1e-4
    forward = rig.ego_from_camera[0, :3, 2].numpy()
    middle = interpolate(table.directions, table.step, np.array([31.5]), np.array([17.5]))[0]
    assert middle @ forward > 0.999


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
