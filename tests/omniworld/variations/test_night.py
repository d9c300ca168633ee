import numpy as np
import pytest

from omniocc.camera import Rig
from omniworld import Scene
from omniworld.mesh.label import PEDESTRIAN, VEHICLE
from omniworld.render.light import LAMP_CELL_M, LAMP_CELLS
from omniworld.traffic.traffic import Actor
from omniworld.variations.night import BASE, BRIGHTNESS, REACH_M, NightScene, headlights, with_beams

RIG = Rig.load("fisheye6").resized(64, 36)
OPTIONS = {"weather": BASE, "lidars": 1, "erp_size": (16, 4), "supersample": 1}


@pytest.fixture(scope="module")
def frames():
    """The same time step at dusk, at night, and at night once more, after another one."""
    dusk, night = (kind("suburb", 3, RIG, **OPTIONS) for kind in (Scene, NightScene))
    again = NightScene("suburb", 3, RIG, **OPTIONS)
    again.frame(0)
    return dusk.frame(5), night.frame(5), again.frame(5)


def test_the_same_frame_is_the_same_in_any_order(frames):
    _, night, again = frames
    for name in ("images", "semantics", "points_m", "lidar_range_m"):
        np.testing.assert_array_equal(getattr(night, name), getattr(again, name))


def test_only_the_light_changes(frames):
    dusk, night, _ = frames
    for name in ("semantics", "range_m", "points_m", "point_labels", "lidar_range_m", "erp_range_m", "world_from_ego"):
        np.testing.assert_array_equal(getattr(night, name), getattr(dusk, name))
    sky = dusk.semantics == 0
    assert night.images[sky].mean() < 0.5 * dusk.images[sky].mean()
    assert night.images[~sky].mean() < dusk.images[~sky].mean()


def actor(label=VEHICLE, length_m=4.0, yaw_rad=0.0):
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    pose[:2, 3] = 100.0, -50.0
    return Actor(1, label, pose, (length_m, 1.8, 1.5), (0.0, 0.0))


def test_cars_have_headlights_where_they_look():
    assert headlights(actor(PEDESTRIAN)) is None
    assert headlights(actor(length_m=1.7)) is None
    place, direction = headlights(actor(yaw_rad=np.pi / 2))
    np.testing.assert_allclose(place, [100.0, -48.0])
    np.testing.assert_allclose(direction, [0.0, 1.0], atol=1e-12)


def light_at(pools, x_m, y_m):
    """Return the light at a place, looked up as the kernel does."""
    return pools.reshape(LAMP_CELLS, LAMP_CELLS)[
        int(np.floor(x_m / LAMP_CELL_M)) % LAMP_CELLS, int(np.floor(y_m / LAMP_CELL_M)) % LAMP_CELLS
    ]


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, -2.5])
def test_beams_lie_ahead_of_the_car_and_nowhere_else(yaw_rad):
    dark = np.zeros(LAMP_CELLS * LAMP_CELLS, np.float32)
    place, ahead = headlights(actor(yaw_rad=yaw_rad))
    pools = with_beams(dark, [(place, ahead)])
    aside = np.array([-ahead[1], ahead[0]])
    assert light_at(pools, *(place + 8 * ahead)) > 0.5 * BRIGHTNESS
    assert light_at(pools, *(place + 8 * ahead + 10 * aside)) < 0.01
    assert light_at(pools, *(place - 3 * ahead)) == 0
    assert light_at(pools, *(place + (REACH_M + 1) * ahead)) == 0
    assert pools.max() <= BRIGHTNESS


def test_beams_never_darken_a_lamp():
    lamps = np.full(LAMP_CELLS * LAMP_CELLS, 0.5, np.float32)
    assert with_beams(lamps, [headlights(actor())[:2]]).min() == 0.5
    assert lamps.max() == 0.5  # the scene's own map is left alone
