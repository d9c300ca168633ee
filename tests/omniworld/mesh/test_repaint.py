import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import concatenate
from omniworld.mesh.repaint import repaint
from omniworld.mesh.shape import Skin, box


def test_only_looks_change_and_equal_skins_stay_equal():
    skins = [Skin(k, material, (200, 20 * k, 90)) for k, material in enumerate(Material, start=0) if k < 12]
    lamp = box((1, 1, 1), (0, 0, 5), Skin(9, Material.LAMP, (255, 250, 240)))
    mesh = concatenate([*(box((1, 1, 1), (k, 0, 0), skin) for k, skin in enumerate(skins)), lamp])
    one, two = (repaint(mesh, np.random.default_rng(seed)) for seed in (0, 0))
    for name in ("vertices", "faces", "uv", "label", "instance"):
        assert np.array_equal(getattr(one, name), getattr(mesh, name))
    assert np.array_equal(one.color, two.color)
    assert np.array_equal(one.material, two.material)
    assert (one.material != mesh.material).mean() > 0.7
    assert (one.material[-12:] == Material.LAMP).all()
    looks = np.column_stack([one.material, one.color])
    assert all(len(np.unique(looks[12 * k : 12 * k + 12], axis=0)) == 1 for k in range(len(skins)))
    other = repaint(mesh, np.random.default_rng(1))
    assert (other.color != one.color).any(1).mean() > 0.9
