import subprocess
import sys

import numpy as np
import pytest

from omniworld.render.caster import Caster, Hits, Layers, library

_DOWN = np.array([[0, 0, -1]], np.float32)


def test_ranges_on_a_plane_and_a_box_are_exact(quad, box):
    rng = np.random.default_rng(0)
    plane = Caster(quad([[-500, -500, 0], [500, -500, 0], [500, 500, 0], [-500, 500, 0]], 1))
    directions = rng.normal(size=(1000, 3))
    directions[:, 2] = -np.abs(directions[:, 2]) - 0.3
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.broadcast_to(np.float32([3, -2, 2.2]), directions.shape)
    hits = plane.cast(origins, directions.astype(np.float32))
    np.testing.assert_allclose(hits.range_m, 2.2 / -directions[:, 2], rtol=2e-6)

    solid = Caster(box([4, -1, -1], [6, 1, 1], 4))
    for direction, expected in (([1, 0, 0], 4.0), ([0.8, 0.0, 0.6], np.inf), ([0.98, 0.199, 0], 4 / 0.98)):
        direction = np.float32([direction / np.linalg.norm(direction)])
        expected = 4 / direction[0, 0] if np.isfinite(expected) else np.inf
        np.testing.assert_allclose(solid.cast(np.zeros((1, 3), np.float32), direction).range_m, [expected], rtol=1e-6)


def test_barycentrics_give_the_point_of_the_hit(street):
    caster = Caster(street)
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(2000, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = np.float32([0, 0, 2.2])
    hits = caster.cast(np.broadcast_to(origin, directions.shape), directions)
    hit = hits.face >= 0
    assert 0.5 < hit.mean() < 1
    assert np.isinf(hits.range_m[~hit]).all()
    corner = street.vertices[street.faces[hits.face[hit]]]
    u, v = hits.u[hit, None], hits.v[hit, None]
    along_face = corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v
    np.testing.assert_allclose(along_face, origin + directions[hit] * hits.range_m[hit, None], atol=1e-4)


def test_nearest_layer_wins_and_faces_count_through(quad, box):
    ground = quad([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], 1)
    crate = box([1, 1, 0], [2, 2, 1], 8)
    layers = Layers([Caster(ground), Caster(crate)])
    origins = np.float32([[1.5, 1.4, 5], [-3, 2, 5], [20, 0, 5]])
    hits = layers.cast(origins, np.repeat(_DOWN, 3, 0))
    np.testing.assert_allclose(hits.range_m, [4, 5, np.inf])
    assert hits.face[0] in (2 + 8, 2 + 9)
    assert hits.face[1] in (0, 1)
    assert hits.face[2] == -1


def test_known_hits_are_kept_where_they_are_nearer(quad):
    layers = Layers([Caster(quad([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], 1))])
    known = Hits(np.float32([3, 7, np.inf]), np.int32([77, 77, -1]), np.float32([0.5, 0.5, 0]), np.float32([0, 0, 0]))
    hits = layers.cast(np.float32([[0, 1, 5]] * 3), np.repeat(_DOWN, 3, 0), known)
    np.testing.assert_allclose(hits.range_m, [3, 5, 5])
    assert hits.face[0] == 77
    assert (hits.face[1:] < 2).all()


def test_blocked_sees_every_layer(quad, box):
    layers = Layers(
        [Caster(quad([[-9, -9, 5], [9, -9, 5], [9, 9, 5], [-9, 9, 5]], 1)), Caster(box([20, 0, 0], [21, 1, 9], 4))]
    )
    origins = np.float32([[0, 0, 0], [20.5, 0.5, -1], [15, 0, 0]])
    assert layers.blocked(origins, np.float32([[0, 0, 1]])).tolist() == [True, True, False]


def test_an_empty_mesh_is_never_hit(street):
    from omniworld.mesh.mesh import empty

    hits = Layers([Caster(empty())]).cast(np.zeros((2, 3), np.float32), np.repeat(_DOWN, 2, 0))
    assert np.isinf(hits.range_m).all()
    assert (hits.face == -1).all()
    assert not Caster(empty()).blocked(np.zeros((2, 3), np.float32), _DOWN).any()


def test_missing_embree_is_one_clear_error(monkeypatch, street):
    monkeypatch.setitem(sys.modules, "embreex", None)
    library.cache_clear()
    with pytest.raises(ImportError, match=r"package 'embreex'.*platform"):
        Caster(street)
    monkeypatch.undo()
    library.cache_clear()
    Caster(street)


def test_import_needs_no_embree():
    code = "import sys; sys.modules['embreex'] = None; import omniworld.render.caster"
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})
