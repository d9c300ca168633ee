import math

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.camera.models.pinhole import Pinhole
from omniworld.drawn import (
    COUNTS,
    FIELD_DEG,
    HEIGHT_M,
    LENSES,
    NARROW_DEG,
    TALL_M,
    car_places,
    draw_any_rig,
    draw_lens,
    draw_rig,
    perturb_rig,
    ring_places,
)

PIXELS = 256 * 144


def rigs(count):
    return [draw_rig(np.random.default_rng(seed), PIXELS) for seed in range(count)]


def test_rigs_are_those_of_their_seeds_and_survive_a_file(tmp_path):
    for seed, rig in enumerate(rigs(8)):
        assert draw_rig(np.random.default_rng(seed), PIXELS) == rig
        rig.save(tmp_path / "rig.yaml")
        assert Rig.load(tmp_path / "rig.yaml") == rig


def test_rigs_are_various_within_their_limits():
    drawn = rigs(200)
    assert {len(rig.cameras) for rig in drawn} >= {1 + n for n in COUNTS if n < 6} | {2}
    assert {type(rig.cameras[0]).__name__ for rig in drawn} == {
        "Equidistant",
        "KannalaBrandt",
        "DoubleSphere",
        "EUCM",
        "MEI",
        "RadialPolynomial",
        "Pinhole",
    }
    heights_m = [-rig.road_z_m for rig in drawn]
    assert HEIGHT_M[0] <= min(heights_m) < 0.7
    assert 2.3 < max(heights_m) <= HEIGHT_M[1]
    sizes = {(rig.cameras[0].width, rig.cameras[0].height) for rig in drawn}
    assert len(sizes) == 4
    assert all(abs(w * h / PIXELS - 1) < 0.06 for w, h in sizes)
    fields_deg = [2 * getattr(rig.cameras[0], "max_angle_deg", 60.0) for rig in drawn]
    assert FIELD_DEG[0] <= min(fields_deg)
    assert 210 < max(fields_deg) <= FIELD_DEG[1]


@pytest.mark.parametrize("lens", [*LENSES, "ocam"])
def test_the_rim_of_the_field_is_where_it_was_asked_for(lens):
    for seed in range(4):
        camera = draw_lens(np.random.default_rng(seed), lens, 256, 200, 190.0, 0.7)
        rim = math.radians(95) * 0.9999
        pixel, valid = camera.project(torch.tensor([math.sin(rim), 0.0, math.cos(rim)], dtype=torch.float64))
        center = camera.project(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))[0]
        assert valid
        assert float((pixel - center).norm()) == pytest.approx(0.7 * 128, rel=2e-3)
        outside = math.radians(95.5)
        assert not camera.project(torch.tensor([math.sin(outside), 0.0, math.cos(outside)], dtype=torch.float64))[1]
        ray, _ = camera.unproject(pixel)
        assert float(ray[2]) == pytest.approx(math.cos(rim), abs=5e-3 if lens == "ocam" else 1e-6)


def test_an_unknown_lens_is_named():
    with pytest.raises(ValueError, match="no lens 'bottle'"):
        draw_lens(np.random.default_rng(0), "bottle", 8, 8, 180.0, 1.0)


def test_rings_look_outwards_and_cars_to_all_sides():
    for place in ring_places(np.random.default_rng(1), 5, 0.8):
        (x, y, _), yaw_deg, *_ = place
        assert math.cos(math.atan2(y, x) - math.radians(yaw_deg)) > 0.9
    yaws = [yaw for _, yaw, _, _ in car_places(np.random.default_rng(1))]
    assert yaws == pytest.approx([0, 90, 180, -90], abs=15)


def test_a_disturbed_rig_is_rigid_and_near():
    rig = rigs(1)[0]
    other = perturb_rig(np.random.default_rng(0), rig, 0.1, 0.003)
    assert other != rig
    change = torch.linalg.inv(rig.ego_from_camera) @ other.ego_from_camera
    angle = torch.acos(((change[:, :3, :3].diagonal(dim1=1, dim2=2).sum(1) - 1) / 2).clamp(max=1))
    assert 0 < float(angle.max()) < math.radians(0.6)
    assert 0 < float(change[:, :3, 3].norm(dim=1).max()) < 0.015


def test_any_rig_is_also_narrow_a_pair_single_or_of_a_truck():
    drawn = [draw_any_rig(np.random.default_rng(seed), PIXELS) for seed in range(300)]
    assert drawn[7] == draw_any_rig(np.random.default_rng(7), PIXELS)
    counts = [len(rig.cameras) for rig in drawn]
    assert min(counts) == 1
    assert {1, 2, 4, 5, 6, 7} <= set(counts)
    narrow = [rig for rig in drawn if isinstance(rig.cameras[0], Pinhole) and field_deg(rig) < NARROW_DEG[1] + 20]
    assert {len(rig.cameras) for rig in narrow} >= {1, 2, 4, 5, 6, 7}
    assert 2.8 < max(-rig.road_z_m for rig in drawn) <= TALL_M[1]
    assert max(float(rig.ego_from_camera[:, :2, 3].abs().max()) for rig in drawn) > 4


def field_deg(rig: Rig) -> float:
    camera = rig.cameras[0]
    return math.degrees(2 * math.atan(camera.width / 2 / camera.focal_px[0]))


def test_random_rigs_are_what_they_were():
    rig = draw_rig(np.random.default_rng(3), PIXELS)
    assert (len(rig.cameras), type(rig.cameras[0]).__name__) == (3, "DoubleSphere")
    assert float(rig.ego_from_camera.sum()) == pytest.approx(-0.38873792399286256, abs=1e-9)
