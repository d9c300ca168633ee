import math
from dataclasses import replace

import pytest
import torch

from omniocc.camera import Rig
from omniocc.model.depth.sweep import box, correlation, peak


def wall_images(rig: Rig, radius_m: float) -> torch.Tensor:
    """What the cameras see inside an upright cylinder of this radius around the ego origin, painted with waves."""
    images = []
    for k in range(len(rig.cameras)):
        rays, seen = rig.rays(k)
        rays = rays.double()
        x, y, z = rig.ego_from_camera[k, :3, 3]
        flat = rays[..., :2].square().sum(-1)
        half = (rays[..., 0] * x + rays[..., 1] * y) / flat
        along = -half + (half.square() - (x * x + y * y - radius_m**2) / flat).sqrt()
        hit = rays * along[..., None] + torch.stack([x, y, z])
        azimuth, height = torch.atan2(hit[..., 1], hit[..., 0]), hit[..., 2]
        paint = sum(
            torch.cos(n * azimuth + m * height + n * m)
            for n, m in ((9, 1.1), (-14, 2.3), (21, -0.7), (5, 3.1), (-3, 1.9))
        )
        images.append(torch.where(seen, 0.5 + 0.09 * paint, 0.0).float())
    return torch.stack(images)[:, None].expand(-1, 3, -1, -1)[None]


def true_range_m(panorama, radius_m):
    rays = panorama.rays()
    return radius_m / rays[..., :2].norm(dim=-1)


@pytest.mark.parametrize("radius_m", [3.0, 6.0])
def test_the_wall_of_a_round_room_is_found(radius_m, small):
    rig = replace(Rig.load("fisheye6").resized(256, 144), masks=None)  # no car stands in the room
    sweep = small("Sweep", width=96, height=24, spheres=24, min_range_m=1.6, window_px=5)
    depth = sweep(wall_images(rig, radius_m), (rig,))
    true_m = true_range_m(sweep.panorama, radius_m)[None]
    middle = torch.zeros_like(depth.valid)
    middle[:, 5:-3] = True
    error = (depth.index - 1.6 * 23 / true_m)[middle].abs()
    assert depth.valid[middle].float().mean() > 0.97
    assert error.median() < 0.15  # of a sphere: a panorama pixel is 3.75 degrees wide, a sphere up to 2
    assert (error < 1).float().mean() > 0.97


def test_correlation_against_numpy_like_loops():
    torch.manual_seed(0)
    swept = torch.rand(1, 3, 6, 8, dtype=torch.float64)
    seen = torch.ones(1, 3, 6, 8, dtype=torch.bool)
    seen[0, 2, 3, 3] = False
    ours = correlation(swept, seen, 3)
    row, column = 2, 0  # its window crosses the seam
    windows = [
        [swept[0, k, row + i, (column + j) % 8].item() for i in (-1, 0, 1) for j in (-1, 0, 1)] for k in range(3)
    ]
    scores = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a, b = torch.tensor(windows[i]), torch.tensor(windows[j])
        a, b = a - a.mean(), b - b.mean()
        scores.append(((a * b).mean() / ((a.square().mean() + 1e-4) * (b.square().mean() + 1e-4)).sqrt()).item())
    assert ours[0, row, column].item() == pytest.approx(sum(scores) / 3, abs=1e-6)
    # camera 2 does not see the whole window there: only the first pair counts
    alone = correlation(swept[:, :2], seen[:, :2], 3)
    assert ours[0, 3, 3].item() == pytest.approx(alone[0, 3, 3].item(), abs=1e-9)
    assert (correlation(swept, torch.zeros_like(seen), 3) == -1).all()


def test_windows_wrap_around():
    maps = torch.zeros(1, 1, 5, 6)
    maps[0, 0, 2, 0] = 9
    assert box(maps, 3)[0, 0, 2].tolist() == [1, 1, 0, 0, 0, 1]


@pytest.mark.parametrize("true", [1.3, 4.0, 5.75])
def test_parabola_finds_the_fraction(true):
    score = 0.9 - 0.1 * (torch.arange(8.0) - true) ** 2
    index, _ = peak(score.view(1, 8, 1, 1))
    assert index.item() == pytest.approx(true, abs=1e-5)


def test_confidence_is_the_lead_over_rivals():
    score = torch.zeros(1, 10, 1, 1)
    score[0, 2], score[0, 3], score[0, 7] = 0.8, 0.7, 0.5
    _, confidence = peak(score)
    assert confidence.item() == pytest.approx(0.3)
    index, confidence = peak(torch.zeros(1, 10, 1, 1))
    assert index.item() == 0
    assert confidence.item() == 0
    assert math.isfinite(peak(torch.full((1, 3, 1, 1), -1.0))[0].item())
