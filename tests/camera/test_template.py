import re

import pytest

from omniocc.camera import Rig
from omniocc.camera.plausible import suspicious
from omniocc.camera.rig import MODELS
from omniocc.camera.template import LENSES, new_rig
from omniocc.errors import UserError


def test_every_lens_model_has_a_template():
    assert set(LENSES) == set(MODELS)


@pytest.mark.parametrize("lens", MODELS)
def test_a_new_rig_loads_at_once_and_nothing_is_suspicious(lens, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(new_rig(lens, 4))
    rig = Rig.load(path)
    assert {type(camera) for camera in rig.cameras} == {MODELS[lens]}
    assert rig.names == ("front", "right", "rear", "left")
    assert rig.ego_from_camera[1, :3, 3].tolist() == [0.0, -0.9, 0.0]
    assert rig.road_z_m == -0.9
    assert suspicious(rig) == []


def test_every_key_is_explained_once():
    first, *others = re.split(r"^  \w+:", new_rig("ocam", 3), flags=re.MULTILINE)[1:]
    assert all("#" in line for line in first.splitlines())
    assert not any("#" in entry for entry in others)


@pytest.mark.parametrize(("count", "last"), [(1, "front"), (6, "front_left"), (8, "front_left"), (13, "camera12")])
def test_names_are_directions_where_they_differ(count, last, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(new_rig("mei", count))
    names = Rig.load(path).names
    assert (len(names), names[-1]) == (count, last)


@pytest.mark.parametrize(
    ("lens", "count", "message"),
    [
        ("kanala_brandt", 4, "did you mean 'kannala_brandt'\\?; lens models: equidistant, pinhole"),
        ("mei", 0, "cameras=0: it must be a whole number, 1 to 100"),
        ("mei", 1.5, "cameras=1.5"),
    ],
)
def test_mistakes_are_named(lens, count, message):
    with pytest.raises(UserError, match=message):
        new_rig(lens, count)
