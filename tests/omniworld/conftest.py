"""A street of boxes between walls, small enough for exact expectations."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omniocc.camera import Rig
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.render.caster import Caster, Layers
from omniworld.render.cull import spheres_of
from omniworld.render.light import Light, Sensor
from omniworld.render.snapshot import Shadows, Snapshot
from omniworld.render.surface import join, make_surfaces
from omniworld.render.weather import draw_light, draw_sensor

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))  # fake_scene


def make_quad(
    corners, label: int, material: Material = Material.CONCRETE, color=(150, 150, 150), instance: int = -1
) -> Mesh:
    corners = np.array(corners, np.float32)
    along = np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[3] - corners[0])
    uv = np.array([[0, 0], [along[0], 0], along, [0, along[1]]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(
        corners,
        faces,
        uv[faces],
        np.full(2, label, np.uint8),
        np.full(2, material, np.uint8),
        np.tile(np.array(color, np.uint8), (2, 1)),
        instance=np.full(2, instance, np.int32),
    )


def make_box(low, high, label: int, **finish) -> Mesh:
    (a, b, c), (d, e, f) = low, high
    sides = [
        [[a, b, c], [d, b, c], [d, b, f], [a, b, f]],
        [[d, b, c], [d, e, c], [d, e, f], [d, b, f]],
        [[d, e, c], [a, e, c], [a, e, f], [d, e, f]],
        [[a, e, c], [a, b, c], [a, b, f], [a, e, f]],
        [[a, b, f], [d, b, f], [d, e, f], [a, e, f]],
        [[a, e, c], [d, e, c], [d, b, c], [a, b, c]],
    ]
    return concatenate([make_quad(side, label, **finish) for side in sides])


@pytest.fixture(scope="session")
def quad():
    return make_quad


@pytest.fixture(scope="session")
def box():
    return make_box


@pytest.fixture(scope="session")
def street() -> Mesh:
    """Build a road at z = 0 for |y| < 5, walls 8 m high on both sides, a house at x 10..16, y 5..9, pole at (6, -3)."""
    return concatenate(
        [
            make_quad([[-60, -5, 0], [60, -5, 0], [60, 5, 0], [-60, 5, 0]], 1, Material.ASPHALT, (90, 90, 90)),
            make_quad([[-60, 5, 0], [60, 5, 0], [60, 40, 0], [-60, 40, 0]], 3, Material.GRASS, (90, 120, 60)),
            make_quad([[-60, -5, 0], [-60, -5, 8], [60, -5, 8], [60, -5, 0]], 5, Material.BRICK, (150, 80, 60)),
            make_box([10, 5, 0], [16, 9, 6], 4, material=Material.FACADE, color=(200, 180, 150)),
            make_box([5.9, -3.1, 0], [6.1, -2.9, 5], 9, material=Material.METAL),
        ]
    )


@pytest.fixture(scope="session")
def ego_car() -> Mesh:
    return make_box([-2, -0.9, -2.1], [2, 0.9, -0.6], 7, material=Material.CAR_PAINT, color=(160, 30, 30))


@pytest.fixture(scope="session")
def noon() -> Light:
    light = draw_light("clear", np.random.default_rng(0))
    direction = np.array([0.0, -0.6, 0.8], np.float32)
    return Light(
        direction,
        np.float32([1, 1, 1]),
        light.zenith,
        light.horizon,
        light.bounce,
        0.0,
        cloud_cover=0.3,
        cloud_shift=light.cloud_shift,
        haze_m=1e6,
    )


@pytest.fixture(scope="session")
def sensor() -> Sensor:
    return draw_sensor(np.random.default_rng(0), draw_light("clear", np.random.default_rng(0)))


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig.load("fisheye6").resized(64, 36)


def make_snapshot(static: Mesh, moving: Mesh, ego_mesh: Mesh, light: Light, x_m: float = 0.0) -> Snapshot:
    """Return a snapshot with the ego at (x_m, 0), 2.2 m above the road, not turned."""
    origin = np.array([x_m, 0, 2.2], np.float32)
    ego_in_world = replace(ego_mesh, vertices=ego_mesh.vertices + origin)
    layers = [Caster(static), Caster(moving)]
    surfaces = join([make_surfaces(static), make_surfaces(moving), make_surfaces(ego_mesh)])
    start = len(static) + len(moving)
    spheres = np.concatenate([spheres_of(moving), spheres_of(ego_in_world)])
    return Snapshot(
        Layers(layers),
        Shadows(layers[0], [layers[1], Caster(ego_in_world)], spheres, light),
        surfaces,
        start,
        np.eye(3, dtype=np.float32),
        origin,
        moving=moving,
        spheres=spheres_of(moving),
        light=light,
    )


@pytest.fixture(scope="session")
def snapshot_of():
    return make_snapshot


@pytest.fixture(scope="session")
def snapshot(street, ego_car, noon) -> Snapshot:
    return make_snapshot(
        street, make_box([8, 1, 0.2], [12, 2.8, 1.6], 7, material=Material.CAR_PAINT, instance=0), ego_car, noon
    )
