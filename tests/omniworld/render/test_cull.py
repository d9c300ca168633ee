import numpy as np
import pytest

from omniworld.mesh.mesh import concatenate, empty
from omniworld.render.caster import Caster
from omniworld.render.cull import ShadowMask, make_cones, may_hit, spheres_of
from omniworld.render.snapshot import Shadows
from omniworld.render.view import make_view


def _rays(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(3, count))
    return (directions / np.linalg.norm(directions, axis=0)).astype(np.float32)


@pytest.fixture(scope="module")
def crates(box):
    rng = np.random.default_rng(5)
    low = rng.uniform(-20, 20, (12, 3)) * (1, 1, 0.1) + (0, 0, 2)
    boxes = [
        box(a, a + s, 7, instance=k) for k, (a, s) in enumerate(zip(low, rng.uniform(0.3, 4, (12, 3)), strict=True))
    ]
    return concatenate(boxes)


def test_spheres_contain_their_instances(crates):
    spheres = spheres_of(crates)
    assert spheres.shape == (12, 4)
    for instance, sphere in enumerate(spheres):
        corner = crates.vertices[crates.faces[crates.instance == instance]].reshape(-1, 3)
        assert np.linalg.norm(corner - sphere[:3], axis=1).max() <= sphere[3]
    assert spheres_of(empty()).shape == (0, 4)


def test_cones_contain_their_rays():
    rays = _rays(4000)
    bundle = np.unique(
        (np.arctan2(rays[1], rays[0]) * 5).astype(int) * 100 + (rays[2] * 9).astype(int), return_inverse=True
    )[1]
    cones = make_cones(rays, bundle)
    angle = np.arccos(np.clip((cones.axis[bundle] * rays.T).sum(axis=1), -1, 1))
    assert (angle <= cones.half_rad[bundle]).all()


def test_every_ray_that_hits_is_kept_and_most_others_are_culled(crates):
    rays = _rays(20000)
    order = np.lexsort((rays[2], np.round(np.arctan2(rays[1], rays[0]) * 12)))
    rays = np.ascontiguousarray(rays[:, order])
    cones = make_cones(rays, np.arange(20000) // 32)
    caster, spheres = Caster(crates), spheres_of(crates)
    for point in np.random.default_rng(1).uniform(-25, 25, (30, 3)).astype(np.float32) * np.float32([1, 1, 0.2]):
        hit = caster.cast(np.broadcast_to(point, (20000, 3)), rays.T).face >= 0
        maybe = may_hit(cones, point, spheres)[cones.bundle]
        assert maybe[hit].all()
    outside = np.float32([60, 0, 2])
    assert may_hit(cones, outside, spheres).mean() < 0.2
    assert not may_hit(cones, outside, spheres[:0]).any()


@pytest.mark.parametrize("height", [0.06, 0.3, 0.7, 1.0])
def test_shadow_mask_contains_every_shadow(crates, height):
    rng = np.random.default_rng(2)
    azimuth = rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - height**2)
    toward = np.float32([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
    points = (rng.uniform(-60, 60, (40000, 3)) * (1, 1, 0.05)).astype(np.float32)
    dark = Caster(crates).blocked(points, toward[None])
    mask = ShadowMask(spheres_of(crates), toward)
    assert dark.sum() > 30
    assert mask.touches(points.T)[dark].all()
    if height > 0.5:
        assert mask.touches(points.T).mean() < 0.2


def test_shadows_equal_those_of_all_casters(crates, street, noon):
    static, movers = Caster(street), [Caster(crates)]
    points = (np.random.default_rng(3).uniform(-30, 30, (20000, 3)) * (1, 1, 0.1) + (0, 0, 2)).astype(np.float32)
    toward = noon.sun_direction[None]
    expected = static.blocked(points, toward) | movers[0].blocked(points, toward)
    shadows = Shadows(static, movers, spheres_of(crates), noon)
    assert np.array_equal(shadows.fall_on(points.T), expected)
    assert 0.02 < expected.mean() < 0.9


def test_casting_with_culling_equals_casting_without(snapshot, rig):
    view = make_view(rig, 0, 1, Caster(empty()))
    maybe = snapshot.may_hit(view.cones, view.origin_m)[view.cones.bundle]
    culled, full = snapshot.cast(view.origin_m, view.center, None, maybe), snapshot.cast(view.origin_m, view.center)
    for one, other in zip(culled, full, strict=True):
        assert np.array_equal(one, other)
    moving = full.face >= snapshot.layers.offsets[1]
    assert moving.sum() > 10
    assert maybe.mean() < 0.5
