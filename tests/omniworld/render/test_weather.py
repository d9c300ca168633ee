from dataclasses import replace

import numpy as np
import pytest

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import concatenate, empty
from omniworld.render.capture import shade, streaks
from omniworld.render.light import lamp_pools
from omniworld.render.surface import lamp_strength
from omniworld.render.weather import WEATHERS, draw_light, draw_sensor, draw_weather


def _colors(snapshot, directions, light):
    directions = np.array(directions, np.float32).T
    directions /= np.linalg.norm(directions, axis=0)
    hits = snapshot.cast(np.zeros(3), directions)
    return shade(
        hits, snapshot.world_point(np.zeros(3)), directions, snapshot.surfaces, snapshot.shadows, light, pixel_rad=0.01
    )


def test_every_weather_is_drawn_and_clear_is_most_common():
    drawn = [draw_weather(np.random.default_rng(seed)) for seed in range(400)]
    counts = {weather: drawn.count(weather) for weather in WEATHERS}
    assert min(counts.values()) > 15
    assert max(counts, key=lambda weather: counts[weather]) == "clear"


@pytest.mark.parametrize("weather", WEATHERS)
def test_lights_have_valid_values(weather):
    for seed in range(20):
        light = draw_light(weather, np.random.default_rng(seed))
        assert np.linalg.norm(light.sun_direction) == pytest.approx(1, abs=1e-6)
        for color in (light.sun, light.zenith, light.horizon, light.bounce):
            assert color.shape == (3,)
            assert color.dtype == np.float32
            assert (color >= 0).all()
        assert light.sun_direction[2] > 0.03
        sensor = draw_sensor(np.random.default_rng(seed), light)
        assert 0 < sensor.exposure < 20


def test_clear_days_have_the_sun_low_and_high():
    heights = [draw_light("clear", np.random.default_rng(seed)).sun_direction[2] for seed in range(40)]
    assert min(heights) < 0.35
    assert max(heights) > 0.85


def test_wrong_weather_is_named():
    with pytest.raises(ValueError, match=r"'hail'.*clear, overcast, rain, fog, dusk"):
        draw_light("hail", np.random.default_rng(0))


def test_fog_hides_distant_objects(snapshot):
    fog = draw_light("fog", np.random.default_rng(1))
    color = _colors(snapshot, [[-59, 4.9, -2.1], [3, 4, -2.2]], fog).color
    far, near = np.abs(color - fog.horizon[:, None]).mean(axis=0)
    assert far < 0.2 * near


def test_wet_road_is_darker_below_and_mirrors_the_sky_ahead(snapshot):
    rain = replace(draw_light("rain", np.random.default_rng(1)), haze_m=1e6)
    dry = replace(rain, wet=0.0)
    views = [[1, 0.5, -2.2], [-40, 0.5, -2.2]]
    wet, before = _colors(snapshot, views, rain).color.mean(axis=0), _colors(snapshot, views, dry).color.mean(axis=0)
    assert wet[0] < before[0]
    assert wet[1] > before[1]


def test_under_a_grey_sky_it_is_dark_below_cars(snapshot_of, street, ego_car, box):
    car = box([4, -1, 0.3], [8, 0.8, 1.6], 7)
    light = draw_light("overcast", np.random.default_rng(0))
    with_car, without = (snapshot_of(street, moving, ego_car, light) for moving in (car, empty()))
    eye = np.array([5.0, -0.1, -2.0])  # of a camera under the car
    directions = np.array([[0.05, 0.0, -1.0]], np.float32).T
    directions /= np.linalg.norm(directions)
    dark, bright = (
        shade(
            s.cast(eye, directions), s.world_point(eye), directions, s.surfaces, s.shadows, light, pixel_rad=0.01
        ).color.mean()
        for s in (with_car, without)
    )
    assert dark < 0.5 * bright


def test_after_dark_lamps_windows_and_the_ground_below_lamps_shine(snapshot_of, street, ego_car, noon, box, quad):
    lamp = quad([[4, 2, 6], [4, 3, 6], [5, 3, 6], [5, 2, 6]], 9, Material.LAMP, (255, 236, 190))
    mesh = concatenate([street, lamp])
    snapshot = snapshot_of(mesh, empty(), ego_car, noon)
    dusk = replace(draw_light("dusk", np.random.default_rng(0)), pools=lamp_pools(mesh), haze_m=1e6)
    off = replace(dusk, lamps=0.0)
    views = [[4.5, 2.5, 3.8], [4.5, 2.5, -2.2], [-30, 2.5, -2.2]]
    lit, dark = _colors(snapshot, views, dusk).color.mean(axis=0), _colors(snapshot, views, off).color.mean(axis=0)
    assert lit[0] > 5 * dark[0]
    assert lit[1] > 1.5 * dark[1]
    assert lit[2] == pytest.approx(dark[2], rel=0.01)


def test_pools_lie_below_lamps_that_face_down(quad):
    down = quad([[4, 2, 6], [4, 3, 6], [5, 3, 6], [5, 2, 6]], 9, Material.LAMP)
    up = quad([[40, 2, 6], [41, 2, 6], [41, 3, 6], [40, 3, 6]], 9, Material.LAMP)
    pools = lamp_pools(concatenate([down, up])).reshape(1024, 1024)
    assert pools[8, 5] > 0.9
    assert pools[8 + 12, 5] == pytest.approx(0.4, abs=0.08)  # about as far off as the lamp is high: 2 ** -1.5
    assert pools[80, 5] == 0


def test_lights_of_cars_and_lamps_have_strength(box):
    head = box([0, 0, 0], [1, 1, 1], 7, material=Material.GLASS, color=(226, 228, 220))
    tail = box([0, 0, 0], [1, 1, 1], 7, material=Material.SIGN, color=(170, 24, 24))
    pane = box([0, 0, 0], [1, 1, 1], 7, material=Material.GLASS, color=(38, 46, 54))
    assert lamp_strength(head).min() > 0
    assert lamp_strength(tail).min() > 0
    assert lamp_strength(pane).max() == 0


def test_streaks_move_from_frame_to_frame_and_leave_most_pixels_free():
    pixel = np.arange(90 * 160)
    one, again, other = (streaks((90, 160), pixel, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert np.array_equal(one, again)
    assert (one != other).mean() > 0.03
    assert 0.02 < (one > 0.05).mean() < 0.4
    assert one.max() <= 0.7
