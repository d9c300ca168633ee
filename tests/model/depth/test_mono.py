import math

import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.model.depth.mono import camera_rays, fill_holes, merge_cameras, range_of_four, ray_maps

INF, NAN = float("inf"), float("nan")
PANORAMA = Equirectangular(16, 5, 45.0, -45.0)
INF = float("inf")


def test_rays_of_a_level_and_a_tilted_camera():
    rig = Rig.load("fisheye6").resized(64, 36)
    maps = ray_maps(rig, torch.device("cpu"))
    assert maps.shape == (6, 4, 36, 64)
    torch.testing.assert_close(maps[:, :3].norm(dim=1), torch.ones(6, 36, 64))
    middle = maps[:, :, 17:19, 31:33].mean((2, 3))
    assert middle[:, 2].tolist() == pytest.approx([1] * 6, abs=1e-3)
    assert middle[:, 3].tolist() == pytest.approx([math.sin(math.radians(-10))] * 6, abs=1e-3)


def test_range_of_four():
    rows = [[3.0, 6.0, INF, INF, INF, 4.0, 5.0, NAN], [6.0, 3.0, INF, 2.0, 4.0, INF, 5.0, INF]]
    blocks = range_of_four(torch.tensor(rows)[None, None])[0, 0, 0]
    assert blocks[:3].tolist() == pytest.approx([4, INF, 4])  # 1 / mean(1/3, 1/6); a lone surface; the two surfaces
    assert blocks[3].isnan()


def test_true_ranges_of_cameras_give_the_true_panorama(small, make_ring, monkeypatch):
    # a ball of 6 m around the ego origin, its range from each camera's own centre
    rig = make_ring(6)
    model = small("Mono", width=16, height=6).eval()
    rays = torch.stack([rig.resized(32, 18).rays(k)[0] for k in range(6)])
    centers_m = rig.ego_from_camera[:, None, None, :3, 3].float()
    along = (rays * centers_m).sum(-1)
    range_m = -along + (along.square() + 36 - centers_m.square().sum(-1)).sqrt()
    sky = torch.full((1, 6, 18, 32), -3.0)
    monkeypatch.setattr(model, "camera_ranges", lambda images, rigs, flip=False: (range_m.log()[None], sky))
    depth = model(torch.rand(1, 6, 3, 36, 64), (rig,))
    assert depth.valid.float().mean() > 0.9
    torch.testing.assert_close(depth.range_m[depth.valid], torch.full_like(depth.range_m[depth.valid], 6.0))
    assert depth.confidence.amax().item() == pytest.approx(1 / (1 + math.exp(-3)), abs=1e-5)
    sky += 6
    doubtful = model(torch.rand(1, 6, 3, 36, 64), (rig,))
    assert not doubtful.valid.any()
    torch.testing.assert_close(doubtful.range_m[depth.valid], depth.range_m[depth.valid])


def test_ranges_of_cameras_are_needed(small, rig):
    with pytest.raises(ValueError, match="range of every camera"):
        small("Mono").weighted_losses(
            torch.rand(1, 6, 3, 36, 64), (rig,), torch.ones(1, 12, 48), None, torch.Generator()
        )


def test_mirrored_images_have_mirrored_ranges(small, make_ring):
    rig, model = make_ring(6), small("Mono").eval()
    images = torch.rand(1, 6, 3, 36, 64)
    with torch.no_grad():
        ours, _ = model.camera_ranges(images, (rig,), flip=True)
        expected, _ = model.camera_ranges(images.flip(-1), (rig,))
    torch.testing.assert_close(ours, expected, atol=1e-4, rtol=1e-4)


def test_a_ball_around_the_origin_is_seen_as_one(rig):
    # range from each camera's centre to a ball of 6 m around the ego origin
    rays, _ = camera_rays(rig, (64, 36), torch.device("cpu"))
    centers_m = rig.ego_from_camera[:, None, None, :3, 3].float()
    along = (rays * centers_m).sum(-1)
    range_m = -along + (along.square() + 36 - centers_m.square().sum(-1)).sqrt()
    assert range_m.amin() == pytest.approx(5.1, abs=0.01)
    assert range_m.amax() > 6.2
    merged, value = merge_cameras(range_m[None], torch.ones(1, 6, 36, 64), torch.ones(1, 6, 36, 64) > 0, rig, PANORAMA)
    seen = merged.isfinite()
    assert seen.float().mean() > 0.95
    torch.testing.assert_close(merged[seen], torch.full_like(merged[seen], 6.0))
    assert torch.equal(value > 0, seen)


def test_holes_take_what_lies_behind():
    rows = torch.full((1, 3, 4), INF)
    rows[0, 1] = torch.tensor([2.0, INF, 9.0, INF])
    filled = fill_holes(rows, 1)
    assert filled[0, 1].tolist() == [2, 9, 9, 9]
    assert filled[0, 0].tolist() == [2, INF, 9, INF]
    assert torch.equal(fill_holes(rows, 0), rows)
