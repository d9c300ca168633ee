import numpy as np
import pytest
import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.draw import render_voxels, voxels
from omniocc.geometry import Cuboid, Cylinder

EYE, TARGET, VIEW_DEG = (-24.0, 5.0, 14.0), (0.0, -1.0, -2.0), 50.0


def rays(width, height):
    """Return the pixel rays of a camera at EYE, from axes computed here."""
    forward = np.subtract(TARGET, EYE) / np.linalg.norm(np.subtract(TARGET, EYE))
    right = np.array([forward[1], -forward[0], 0]) / np.hypot(forward[0], forward[1])
    up = np.cross(right, forward)
    half = np.tan(np.radians(VIEW_DEG / 2))
    u = ((np.arange(width) + 0.5) / width * 2 - 1) * half
    v = ((np.arange(height) + 0.5) / height * 2 - 1) * half * height / width
    return forward + u[None, :, None] * right - v[:, None, None] * up


@pytest.mark.parametrize(
    "geometry",
    [
        Cylinder(shape=(24, 50, 6), radius_m=(0.0, 12.0), height_m=(-2.8, 3.6)),
        Cuboid(shape=(20, 30, 6), x_m=(-10, 12), y_m=(-11, 11), height_m=(-2.8, 3.6)),
    ],
    ids=["cylinder", "cuboid"],
)
def test_every_pixel_shows_the_first_cell_along_its_ray(geometry, monkeypatch):
    torch.manual_seed(0)
    labels = torch.randint(1, 12, geometry.shape, dtype=torch.uint8)
    labels[torch.rand(geometry.shape) > 0.06] = 0
    labels[..., 0] = 3
    monkeypatch.setattr(voxels, "SUPERSAMPLE", 1)
    monkeypatch.setattr(voxels, "EDGE_DARKENING", 0)
    monkeypatch.setattr(voxels, "CAR_BOXES", ())
    monkeypatch.setattr(voxels, "_shade", lambda faces: faces.colors)
    width, height = 480, 320
    image = render_voxels(labels, geometry, WORLD_CLASSES, width, height, EYE, TARGET, VIEW_DEG)
    directions = torch.from_numpy(rays(width, height).reshape(-1, 3))
    origins = torch.tensor(EYE, dtype=torch.float64).expand_as(directions)
    _, first = geometry.trace(labels, origins, directions, hit="entry")
    first = first.numpy().reshape(height, width)
    palette = WORLD_CLASSES.palette
    shown = np.where((image[:, :, None] == palette[1:12]).all(3).any(2), image.astype(int) @ [1, 256, 65536], -1)
    expected = np.where(first > 0, palette[first].astype(int) @ [1, 256, 65536], -1)
    windows = np.lib.stride_tricks.sliding_window_view(first, (5, 5))
    inner = np.zeros_like(first, dtype=bool)
    inner[2:-2, 2:-2] = (windows == first[2:-2, 2:-2, None, None]).all((2, 3))  # outlines are up to 2 px wide
    assert inner.mean() > 0.5
    assert (first[inner] > 0).mean() > 0.3
    assert (shown == expected)[inner].mean() > 0.995


def test_unknown_and_free_are_invisible_and_the_background_light():
    geometry = Cuboid(shape=(8, 8, 4))
    labels = torch.full(geometry.shape, 255, dtype=torch.uint8)
    labels[:4] = 0
    empty = render_voxels(torch.zeros_like(labels), geometry, WORLD_CLASSES, 96, 54)
    assert np.array_equal(render_voxels(labels, geometry, WORLD_CLASSES, 96, 54), empty)
    assert empty[:5].min() > 200


def test_cells_keep_their_side():
    geometry = Cylinder(shape=(16, 40, 8))
    labels = torch.zeros(geometry.shape, dtype=torch.uint8)
    index, _ = geometry.index(torch.tensor([5.0, 9.0, 0.0]))  # ahead, left
    labels[tuple(index.tolist())] = 10
    image = render_voxels(labels, geometry, WORLD_CLASSES, 96, 54).astype(int)
    red = (image[..., 0] - image[..., 2]) > 80
    assert red.any()
    assert np.nonzero(red)[1].max() < 48
