import numpy as np
import pytest
from plain_shading import sample

from omniworld.mesh.material import Material
from omniworld.render.texture import atlas


def _grid(side_m: float, count: int = 96) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(0, side_m, count, dtype=np.float32), np.linspace(0, side_m, count, dtype=np.float32))
    return u.ravel(), v.ravel()


def _colors(material: Material, u, v, footprint_m: float, color=(150, 140, 130)) -> np.ndarray:
    """Return (3, R) linear colours."""
    count = len(u)
    layer, ground = atlas.layer_of(np.full(count, material, np.uint8), np.tile(np.uint8(color), (count, 1)))
    tint, added = sample(layer, ground, u, v, np.full(count, footprint_m, np.float32))
    return 0.2 * tint + added


def _value(material: Material, side_m: float, footprint_m: float) -> np.ndarray:
    return _colors(material, *_grid(side_m), footprint_m).mean(axis=0)


@pytest.mark.parametrize(
    "material",
    [
        Material.ASPHALT,
        Material.PAVING,
        Material.GRASS,
        Material.SOIL,
        Material.BRICK,
        Material.FACADE,
        Material.LEAVES,
        Material.BARK,
    ],
)
def test_stereo_finds_contrast_near_and_far(material):
    near, far = _value(material, 1.5, 0.0), _value(material, 25.0, 0.15)
    assert near.std() / near.mean() > 0.06
    assert far.std() / far.mean() > 0.05


@pytest.mark.parametrize("material", list(Material))
def test_far_away_a_texture_keeps_its_mean_and_loses_its_detail(material):
    made = atlas.make_atlas()
    size_m = float(made.texel_m[material]) * atlas.SIZE_PX
    u, v = _grid(size_m * 95 / 96)
    near, far = _colors(material, u, v, 0.0), _colors(material, u, v, 1e6)
    np.testing.assert_allclose(far.mean(), near.mean(), rtol=0.08)
    assert far.std() <= near.std() + 1e-6


def test_textures_move_with_the_surface_and_repeat():
    made = atlas.make_atlas()
    size_m = float(made.texel_m[Material.BRICK]) * atlas.SIZE_PX
    u, v = _grid(1.0)
    layer = np.full(len(u), Material.BRICK, np.int32)
    zero = np.zeros(len(u), np.int32)
    _, first = sample(layer, zero, u, v, np.zeros_like(u))
    _, shifted = sample(layer, zero, u + 3 * size_m, v - 2 * size_m, np.zeros_like(u))
    assert (first != shifted).mean() < 0.02  # float32 rounding at the borders of texels


def test_ground_floor_of_a_facade_differs_and_walls_of_one_colour_have_one_style():
    u, v = _grid(12.8)
    low = _colors(Material.FACADE, u, v % 3.1, 0.0)
    high = _colors(Material.FACADE, u, v % 3.1 + 3.2, 0.0)
    assert np.abs(low - high).mean() > 0.02
    colors = np.array([[200, 180, 150], [200, 180, 150], [120, 60, 50], [90, 100, 110]], np.uint8)
    layer, ground = atlas.layer_of(np.full(4, Material.FACADE, np.uint8), colors)
    assert layer[0] == layer[1]
    assert (ground == 1).all()
    assert (layer >= len(Material)).all()


def test_base_colour_tints_walls_but_not_windows():
    u, v = _grid(12.8)
    layer, ground = atlas.layer_of(
        np.full(len(u), Material.FACADE, np.uint8), np.tile(np.uint8([200, 180, 150]), (len(u), 1))
    )
    tint, added = sample(layer, ground, u, v + 3.2, np.zeros_like(u))
    glass = tint == 0
    assert 0.05 < glass.mean() < 0.6
    assert added[:, glass].min() > 0
    assert np.median(tint[~glass]) > 0.5


def test_atlas_is_the_same_in_every_process():
    again = atlas.make_atlas.__wrapped__()
    assert np.array_equal(again.texels, atlas.make_atlas().texels)
    assert np.array_equal(again.macro, atlas.make_atlas().macro)
