"""The nearest of points in each pixel of a panorama."""

import math

import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.model.ops.depth.z_buffer import draw_front

INF = float("inf")
PANORAMA = Equirectangular(16, 5, 45.0, -45.0)


def looped(points_m, value, drawn):
    """Nearest point per pixel, then weighted means over the points of that surface, point by point."""
    places, nearest = [], {}
    for (x, y, z), counts in zip(points_m.tolist(), drawn.tolist(), strict=True):
        column = (math.pi - math.atan2(y, x)) / (2 * math.pi) * 16 - 0.5
        row = (45 - math.degrees(math.atan2(z, math.hypot(x, y)))) / 90 * 5 - 0.5
        range_m = math.sqrt(x * x + y * y + z * z)
        places.append((column, row, range_m, counts and -0.5 <= row <= 4.5))
        if places[-1][-1]:
            key = (round(row), round(column) % 16)
            nearest[key] = min(nearest.get(key, INF), range_m)
    ranges, values = torch.full((5, 16), INF, dtype=torch.float64), torch.zeros(5, 16, dtype=torch.float64)
    for (row, column), front in nearest.items():
        weight = inverse = total = 0.0
        for (x, y, range_m, counts), each in zip(places, value.tolist(), strict=True):
            gap = abs((x - column + 8) % 16 - 8)
            part = max(0, 1 - gap) * max(0, 1 - abs(y - row)) * (counts and range_m <= 1.5 * front)
            weight, inverse, total = weight + part, inverse + part / range_m, total + part * each
        ranges[row, column], values[row, column] = weight / inverse, total / weight
    return ranges, values


def test_front_of_each_pixel():
    torch.manual_seed(0)
    points_m = 4 * torch.randn(2, 300, 3, dtype=torch.float64)
    value, drawn = torch.rand(2, 300, dtype=torch.float64), torch.rand(2, 300) < 0.8
    front, values = draw_front(points_m, value, drawn, PANORAMA)
    for sample in range(2):
        expected, expected_values = looped(points_m[sample], value[sample], drawn[sample])
        torch.testing.assert_close(front[sample], expected)
        torch.testing.assert_close(values[sample], expected_values)
    assert front.isinf().any()


def test_slanted_ground_is_not_too_near():
    # a plane 2 m below, by many points in each pixel: the nearest of them would be up to half a pixel too near
    pixels = torch.stack(torch.meshgrid(torch.arange(0, 16, 0.1), torch.arange(3, 4.5, 0.1), indexing="xy"), -1)
    rays = PANORAMA.unproject(pixels.double())[0]
    points_m = (rays * (-2 / rays[..., 2:])).reshape(1, -1, 3)
    front, _ = draw_front(points_m, torch.ones(1, len(points_m[0])), torch.ones(1, len(points_m[0])) > 0, PANORAMA)
    expected_m = 2 / math.sin(math.radians(36))
    assert front[0, 4].tolist() == pytest.approx([expected_m] * 16, rel=0.06)
    assert points_m.norm(dim=-1).view(15, 160)[5:].amin().item() < 0.9 * expected_m


def test_straight_behind():
    nearest, _ = draw_front(torch.tensor([[[-2.0, 0.0, 0.0]]]), torch.ones(1, 1), torch.tensor([[True]]), PANORAMA)
    assert nearest[0, 2, 0] == 2 or nearest[0, 2, 15] == 2
