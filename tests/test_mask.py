"""The script `mask.py`."""

import re
from dataclasses import replace

import cv2
import pytest
import torch
from scripts import run_script

from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.config import build
from omniocc.errors import UserError
from omniworld.mask import read_car
from omniworld.render.own_car import mask_ego_car


@pytest.fixture(scope="module")
def scene(composed, tmp_path_factory):
    """Return one recorded scene of the smallest preset, two frames long."""
    root = tmp_path_factory.mktemp("recorded")
    overrides = [f"paths.data={root}", "data.source.workers=0", "data.source.train_scenes=1"]
    world = build(composed("preset=smoke", *overrides).data.source)
    world.prepare(world.plans[:1])
    return world.reader(world.plans[0])


def test_a_rig_is_masked_and_drawn(tmp_path):
    output = tmp_path / "masked.yaml"
    result = run_script("mask.py", "rig=pinhole6", f"output={output}", "grow_px=2")
    assert result.returncode == 0, result.stderr
    rig, picture = Rig.load(output), cv2.imread(str(tmp_path / "masked.masks.png"))
    assert picture.shape[1] == 1280
    assert rig.names == Rig.load("pinhole6").names
    assert re.search(r"^rear +own car +1[0-9]\.\d%   usable +8\d\.\d%$", result.stdout, re.M)
    assert rig.masks[rig.names.index("front")] is None
    assert rig.rays(rig.names.index("rear"))[1].sum() < Rig.load("pinhole6").rays(rig.names.index("rear"))[1].sum()


@pytest.mark.parametrize("x", ["nan", "inf", "1e6"])
def test_corners_of_a_car_are_near_the_ego_origin(x, tmp_path):
    path = tmp_path / "car.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv {x} 1 0\nf 1 2 3\n")
    with pytest.raises(UserError, match=r"car\.obj: a vertex is not within 100 m of the ego origin"):
        read_car(path)


def test_the_car_stands_on_the_road_of_the_rig(tmp_path):
    """A road that is .3 m higher brings the car nearer to the cameras, as in scenes of the virtual world."""
    rig = replace(Rig.load("pinhole6"), road_z_m=-1.9)
    rig.save(tmp_path / "higher.yaml")
    result = run_script("mask.py", f"rig={tmp_path / 'higher.yaml'}", f"output={tmp_path / 'masked.yaml'}", "grow_px=0")
    assert result.returncode == 0, result.stderr
    assert Rig.load(tmp_path / "masked.yaml").masks[rig.names.index("rear")].float().mean() < 0.75
    assert Rig.load(tmp_path / "masked.yaml") == mask_ego_car(rig)


@pytest.mark.slow
def test_recorded_scenes_carry_a_rig_that_leaves_out_their_own_car(scene):
    for camera, labels in enumerate(scene.pixel_labels(0)):
        usable = scene.rig.rays(camera)[1]
        assert torch.equal(usable, usable & torch.from_numpy(labels != UNKNOWN))
    assert scene.rig.masks is not None


def test_masks_are_found_from_the_labels_of_recorded_scenes(scene, tmp_path):
    output = tmp_path / "masked.yaml"
    result = run_script("mask.py", f"scenes={scene.folder.parent}", f"output={output}", "grow_px=0")
    assert result.returncode == 0, result.stderr
    assert Rig.load(output) == scene.rig


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either rig=... or scenes=..."),
        (["rig=pinhole6", "scenes=."], "give either rig=... or scenes=..."),
        (["rig=pinhole7"], "did you mean 'pinhole6'?"),
        (["rig=pinhole6", "car=none.obj"], "none.obj cannot be read"),
        (["scenes=."], "there are no recorded scenes"),
        (["rig=surround_view"], "a camera of this rig would be inside of the virtual world's car"),
        (["rig=pinhole6", "grow_px=-1"], "grow_px=-1: give whole pixels"),
        (["rig=pinhole6", "grow_px=1.5"], "grow_px=1.5: give whole pixels"),
    ],
)
def test_mistakes_are_named_in_a_line(arguments, message, tmp_path):
    result = run_script("mask.py", *arguments, "output=masked.yaml", cwd=tmp_path)
    assert result.returncode == 1
    assert message in result.stderr
    assert not list(tmp_path.iterdir())
