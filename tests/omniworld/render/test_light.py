from dataclasses import replace

import numpy as np
import pytest
from plain_shading import ambient
from plain_shading import shade as shade_plainly

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import concatenate, empty
from omniworld.render.capture import develop, shade
from omniworld.render.caster import no_hits
from omniworld.render.light import lamp_pools
from omniworld.render.weather import WEATHERS, draw_light, draw_sensor


def _sensor(seed=0):
    rng = np.random.default_rng(seed)
    return draw_sensor(rng, draw_light("clear", rng))


def test_shadow_is_darker_than_sun_by_the_ratio_of_the_light(snapshot, noon):
    """The south wall at y = -5 shades the road up to y = 1 from the sun (direction 0, -0.6, 0.8)."""
    directions = np.array([[3.0, 0.5, -2.2], [3.0, 4.0, -2.2]]).T
    directions = (directions / np.linalg.norm(directions, axis=0)).astype(np.float32)
    hits = snapshot.cast(np.zeros(3), directions)
    assert snapshot.surfaces.label[hits.face].tolist() == [1, 1]
    shaded = shade(
        hits, snapshot.world_point(np.zeros(3)), directions, snapshot.surfaces, snapshot.shadows, noon, pixel_rad=1e6
    )
    assert shaded.lit.tolist() == [False, True]
    dark, bright = shaded.color.T
    dim = ambient(noon, np.float32([1.0]))[:, 0]
    # Textured at the coarsest mip level, so that only the slow variation of brightness differs.
    np.testing.assert_allclose(bright / dark, (noon.sun * 0.8 + dim) / dim, rtol=0.35)
    assert (bright > 1.5 * dark).all()


def test_ego_car_casts_a_shadow_and_the_lidars_do_not_see_it(snapshot_of, street, ego_car, noon):
    snapshot = snapshot_of(street, empty(), ego_car, replace(noon, sun_direction=np.float32([0, 0, 1])))
    below, aside = np.float32([0, 0, -1]), np.float32([0, 0.8, -0.6])
    directions = np.stack([below, aside], axis=1)
    hits = snapshot.cast(np.zeros(3), directions)
    assert snapshot.surfaces.label[hits.face].tolist() == [1, 1]
    shaded = shade(
        hits,
        snapshot.world_point(np.zeros(3)),
        directions,
        snapshot.surfaces,
        snapshot.shadows,
        snapshot.light,
        pixel_rad=0.01,
    )
    assert shaded.lit.tolist() == [False, True]


@pytest.mark.parametrize("weather", WEATHERS)
def test_colours_equal_those_of_plain_numpy(weather, snapshot_of, street, ego_car, box, quad):
    lamp = quad([[4, 2, 6], [4, 3, 6], [5, 3, 6], [5, 2, 6]], 9, Material.LAMP, (255, 236, 190))
    car = box([8, 1, 0.2], [12, 2.8, 1.6], 7, material=Material.CAR_PAINT)
    window = box([5, -2, 0.2], [6, -1, 2], 4, material=Material.GLASS)
    static = concatenate([street, lamp, window])
    light = draw_light(weather, np.random.default_rng(0))
    light = replace(light, pools=lamp_pools(static)) if light.lamps else light
    snapshot = snapshot_of(static, car, ego_car, light)
    directions = np.random.default_rng(1).normal(size=(3, 20000)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=0)
    hits = snapshot.cast(np.zeros(3), directions)
    seen = (hits, snapshot.world_point(np.zeros(3)), directions, snapshot.surfaces, snapshot.shadows, light, 0.01)
    found, expected = shade(*seen), shade_plainly(*seen)
    other = np.abs(found.color - expected.color).max(axis=0) > 2e-5
    assert other.sum() <= 10, "at most ten of 20,000 rays may see the next texel, as rounded positions at its border do"
    assert np.array_equal(found.offset_m, expected.offset_m)
    assert np.array_equal(found.lit, expected.lit)
    assert 0.1 < (hits.face < 0).mean() < 0.9
    assert len(np.unique(found.color[0])) > 10000


def test_sky_is_brightest_at_the_sun_and_has_clouds(snapshot):
    light = draw_light("clear", np.random.default_rng(0))
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(3, 4000)).astype(np.float32)
    directions[2] = np.abs(directions[2]) + 0.3
    directions /= np.linalg.norm(directions, axis=0)

    def sky_color(toward):
        nothing = no_hits(toward.shape[1])
        return shade(nothing, np.zeros(3), toward, snapshot.surfaces, snapshot.shadows, light, pixel_rad=0.01).color

    sky = sky_color(directions)
    assert np.isfinite(sky).all()
    assert sky.min() > 0
    assert sky.std(axis=1).min() > 0.02
    if light.glow > 0:
        at_sun = sky_color(light.sun_direction[:, None])
        assert at_sun.mean() > sky.mean(axis=1).max()


def test_developing_is_monotonic_saturates_and_darkens_to_the_rim():
    sensor = _sensor()
    ramp = np.tile(np.linspace(0, 6, 2000, dtype=np.float32), (3, 1))
    rgb = develop(ramp, sensor, np.zeros(2000, np.float32), np.random.default_rng(0)).astype(float)
    smooth = rgb.reshape(20, 100, 3).mean(axis=1)
    assert (np.diff(smooth, axis=0) > -1).all()
    assert rgb[:3].max() < 45
    assert smooth[-1].min() > 230
    grey = np.full((3, 5000), 0.2, np.float32)
    middle, rim = (develop(grey, sensor, np.full(5000, f, np.float32), np.random.default_rng(0)).mean() for f in (0, 1))
    assert rim < middle - 5


def test_noise_depends_on_the_generator_only():
    sensor, grey = _sensor(), np.full((3, 5000), 0.2, np.float32)
    flat = np.zeros(5000, np.float32)
    first, again, other = (develop(grey, sensor, flat, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert (first != other).mean() > 0.3
    assert 0.5 < first.std() < 12
