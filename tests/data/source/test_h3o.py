"""H3O: a small dataset in the layout that its author's code reads."""

import json
import math

import numpy as np
import pytest
from rival_files import write_h3o

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.h3o import H3O, range_of_cube_depth

SAME = {"train": "train", "val": "val", "test": "test"}
# of the tags 0 to 28: road 1, side 2, building 3-5, pole 6-8, plants 9 and 10, sky 11, people 12 and 13, car, truck,
# bus, train, motorcycle, bicycle, static, dynamic, other, water, road lines, ground, bridge, rails, guard rail
CLASS_OF_TAG = [0, 1, 2, 3, 3, 3, 10, 10, 10, 4, 4, 0, 9, 9, 5, 6, 7, 0, 8, 8, 0, 0, 0, 0, 1, 0, 0, 0, 0]


def source_of(root, places="homo", splits=SAME, cell_m=0.4, y="right"):
    source = H3O(
        str(root), places, splits, cell_m, y, image_width=64, panorama=(32, 16, 45.0, -45.0), road_z_m=-1.7, cache=None
    )
    source.prepare()
    return source


@pytest.mark.parametrize(("cell_m", "shape"), [(0.4, (64, 64, 8)), (0.2, (128, 128, 16))])
def test_a_small_dataset_is_read(tmp_path, cell_m, shape):
    source = source_of(write_h3o(tmp_path), cell_m=cell_m)
    scene = source.scenes("train")[0]
    assert isinstance(source, SceneSource)
    assert isinstance(scene, SceneFrames)
    names = [source.scenes(split)[0].name for split in SAME]
    assert names == ["sequences-Town01_a", "sequences-Town02_a", "sequences-Town02_b"]
    assert source_of(tmp_path, splits=SAME | {"test": "val"}).scenes("test")[0].name == names[1]
    assert scene.numbers == ["000000", "000001"]
    assert (scene.world_from_ego == np.eye(4)).all()
    voxels = scene.own_voxels(0, "none")
    assert source.grid.shape == tuple(voxels.shape) == shape
    assert voxels[20:49, -3, 7].tolist() == CLASS_OF_TAG
    assert scene.benchmark(0).scored is None
    wall = source.grid.centers()[10, voxels[10, :, -1] == 3, -1, 1]
    assert wall.tolist() == pytest.approx([-5.0], abs=0.11)  # at the right; our y points to the left
    left = source_of(tmp_path, cell_m=cell_m, y="left").scenes("train")[0].own_voxels(0, "none")
    assert (left.flip(1) == voxels).all()
    (image,) = scene.images(0)
    assert image.shape == (32, 64, 3)
    assert image[:, 40].mean(0).tolist() == pytest.approx([200, 0, 0], abs=1)  # red is on the right
    rig = source.rig
    pixels, valid = rig.project(rig.ego_from_camera.new_tensor([[5.0, 0.0, 0.0], [0.0, -5.0, 0.0], [3.0, 0.0, -3.0]]))
    assert valid.all()
    assert pixels[0].tolist() == [pytest.approx(point) for point in ([31.5, 15.5], [47.5, 15.5], [31.5, 23.5])]
    (range_m,) = scene.camera_range_m(0)
    assert np.isinf(range_m[0]).all()
    assert 4 <= range_m[8:].min() < 4.05
    assert 6.3 < range_m[8:].max() <= 4 * math.sqrt(3)  # the corners of the room
    assert scene.erp_range_m(0).shape == (16, 32)


def test_depth_is_planar_on_the_faces_of_a_cube():
    depth_m = np.full((180, 360), 4.0, np.float32)
    depth_m[0, :3] = 0, -1, np.nan  # nothing was measured
    range_m = range_of_cube_depth(depth_m)
    assert np.isnan(range_m[0, :3]).all()
    assert np.isfinite(range_m[1:]).all()
    ray = np.array([math.cos(math.radians(44.5)), math.sin(math.radians(44.5))]) * math.cos(math.radians(0.5))
    assert range_m[89, 224] == pytest.approx(4 / ray[0])  # beside the edge of two faces: 5.6 m, not 4
    assert range_m[89, 180] == pytest.approx(4, abs=1e-3)


SPLITS, VOXELS = "splits_homo.json", "sequences/Town01_a/occupancy_gt/000000.npy"
TWICE = {"train": ["sequences/Town01_a"] * 2, "val": [], "test": []}


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (SPLITS, "[1]", r"splits_homo\.json: it must hold lists of folders by split"),
        (SPLITS, json.dumps({"train": [], "val": []}), "no split test, only train, val; set data"),
        (SPLITS, json.dumps(TWICE), "the folder 'sequences/Town01_a' stands twice in train"),
        (SPLITS, json.dumps(SAME | {"train": ["gone"]}), "gone.* not found"),
        (VOXELS, "no", r"H3O, scene 'sequences-Town01_a', frame 0: .*000000\.npy: the file is damaged"),
        (VOXELS, np.full((64, 64, 8), 300, np.uint16), r"000000\.npy: the class ids \[300\] are not in"),
        (VOXELS, np.zeros((32, 64, 8), np.uint8), r"has the shape \(32, 64, 8\) instead of \(64, 64, 8\)"),
        ("sequences/Town01_a/panorama_depth_m/000000.npy", "no", r"frame 0: .*000000\.npy: the file is damaged"),
        ("sequences/Town01_a/panorama_depth_m/000000.npy", np.zeros((2, 2), int), r"000000\.npy: an array of int64"),
        ("sequences/Town01_a/panorama_rgb/000000.png", "no", r"frame 0: .*000000\.png: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    path = write_h3o(tmp_path, frames=1) / file
    path.write_text(content) if isinstance(content, str) else np.save(path, content)
    with pytest.raises(DataError, match=message):
        read_all(tmp_path)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.erp_range_m(0), scene.images(0)


def test_impossible_options_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"places must be homo or heter, y right or left, and cell_m"):
        source_of(tmp_path, places="all")
    with pytest.raises(ValueError, match="splits need train, val, test, got"):
        source_of(tmp_path, splits={})
