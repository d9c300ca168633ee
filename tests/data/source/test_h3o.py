"""H3O: a small dataset in the layout that its author's code reads, literal values of tags, sides and ranges."""

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


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_h3o(tmp_path_factory.mktemp("h3o"))


def source_of(root, places="homo", splits=SAME, cell_m=0.4, y="right"):
    source = H3O(str(root), places, splits, cell_m, y, 64, (32, 16, 45.0, -45.0), -1.7, None)
    source.prepare()
    return source


def test_it_keeps_the_contracts_and_the_files_say_the_split(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert [source.scenes(split)[0].name for split in SAME] == [
        "sequences-Town01_a", "sequences-Town02_a", "sequences-Town02_b",
    ]  # fmt: skip
    assert (len(scene), scene.numbers) == (2, ["000000", "000001"])
    assert (scene.world_from_ego == np.eye(4)).all()
    assert scene.pixel_labels(0) is scene.lidar(0) is scene.points(0) is None
    with pytest.raises(ValueError, match="unseen: there is no mask"):
        source.labels(source.grid, "unseen")
    validated = source_of(root, splits=SAME | {"test": "val"})
    assert [scene.name for scene in validated.scenes("test")] == ["sequences-Town02_a"]


# of the tags 0 to 28: road 1, side 2, building 3-5, pole 6-8, plants 9 and 10, sky 11, people 12 and 13, car, truck,
# bus, train, motorcycle, bicycle, static, dynamic, other, water, road lines, ground, bridge, rails, guard rail
CLASS_OF_TAG = [0, 1, 2, 3, 3, 3, 10, 10, 10, 4, 4, 0, 9, 9, 5, 6, 7, 0, 8, 8, 0, 0, 0, 0, 1, 0, 0, 0, 0]


def test_tags_become_classes_and_all_others_are_empty(root):
    for cell_m, shape in ((0.4, (64, 64, 8)), (0.2, (128, 128, 16))):
        source = source_of(root, cell_m=cell_m, y="left")
        scene = source.scenes("train")[0]
        voxels = scene.own_voxels(0, "none")
        assert source.grid.shape == tuple(voxels.shape) == shape
        assert voxels[20:49, 2, 7].tolist() == CLASS_OF_TAG
        assert 255 not in voxels
        assert scene.benchmark(0).scored is None


def test_the_right_of_the_image_is_the_right_of_the_voxels(root):
    source = source_of(root)
    scene, grid = source.scenes("train")[0], source.grid
    wall = scene.own_voxels(0, "none")[10, :, 6].nonzero().flatten().tolist()
    assert [round(float(grid.centers()[10, y, 6, 1]), 3) for y in wall] == [-5.0]  # our y points to the left
    left_says_the_comment = source_of(root, y="left").scenes("train")[0].own_voxels(0, "none")
    assert (left_says_the_comment.flip(1) == scene.own_voxels(0, "none")).all()
    (image,) = scene.images(0)
    assert image.shape == (32, 64, 3)
    assert image[:, 40].mean(0).tolist() == pytest.approx([200, 0, 0], abs=1)  # red is on the right
    rig = source.rig
    pixels, valid = rig.project(rig.ego_from_camera.new_tensor([[5.0, 0.0, 0.0], [0.0, -5.0, 0.0], [3.0, 0.0, -3.0]]))
    assert valid.all()
    assert pixels[0].tolist() == [pytest.approx(point) for point in ([31.5, 15.5], [47.5, 15.5], [31.5, 23.5])]


def test_depth_is_planar_on_the_faces_of_a_cube(root):
    depth_m = np.full((180, 360), 4.0, np.float32)
    depth_m[0, :3] = 0, -1, np.nan  # nothing was measured
    range_m = range_of_cube_depth(depth_m)
    assert np.isnan(range_m[0, :3]).all()
    assert np.isfinite(range_m[1:]).all()
    ray = np.array([math.cos(math.radians(44.5)), math.sin(math.radians(44.5))]) * math.cos(math.radians(0.5))
    assert range_m[89, 224] == pytest.approx(4 / ray[0])  # beside the edge of two faces: 5.6 m, not 4
    assert range_m[89, 224] > 5.6
    assert range_m[89, 180] == pytest.approx(4, abs=1e-3)
    scene = source_of(root).scenes("train")[0]
    (pixels_m,) = scene.camera_range_m(0)
    assert np.isinf(pixels_m[0]).all()
    assert 4 <= pixels_m[8:].min() < 4.05
    assert 6.3 < pixels_m[8:].max() <= 4 * math.sqrt(3)  # the corners of the room
    panorama = scene.erp_range_m(0)
    assert panorama.shape == (16, 32)
    assert np.isfinite(panorama).all()


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("splits_homo.json", b"[1]", r"splits_homo\.json: it must hold lists of folders by split"),
        ("splits_homo.json", json.dumps({"train": [], "val": []}).encode(), "no split test, only train, val; set data"),
        (
            "splits_homo.json",
            json.dumps({"train": ["sequences/Town01_a"] * 2, "val": [], "test": []}).encode(),
            "the folder 'sequences/Town01_a' stands twice in train",
        ),
        ("splits_homo.json", b'{"train": [], "train": []}', r"splits_homo\.json: .*the key 'train' stands twice"),
        ("splits_homo.json", json.dumps(SAME | {"train": ["gone"]}).encode(), "gone.* not found"),
        ("sequences/Town01_a/occupancy_gt/000000.npy", b"no", r"H3O, scene 'sequences-Town01_a', frame 0: .*damaged"),
        ("sequences/Town01_a/panorama_depth_m/000000.npy", b"no", r"frame 0: .*000000\.npy: the file is damaged"),
        ("sequences/Town01_a/panorama_rgb/000000.png", b"no", r"frame 0: .*000000\.png: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_h3o(tmp_path, frames=1)
    (root / file).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.erp_range_m(0), scene.images(0)


def test_impossible_options_and_tags_are_named(root, tmp_path):
    with pytest.raises(ValueError, match=r"places must be homo or heter, y right or left, and cell_m"):
        source_of(root, places="all")
    write_h3o(tmp_path, frames=1)
    path = tmp_path / "sequences" / "Town01_a" / "occupancy_gt" / "000000.npy"
    np.save(path, np.full((64, 64, 8), 300, np.uint16))
    with pytest.raises(DataError, match=r"000000\.npy: the class ids \[300\] are not in"):
        source_of(tmp_path).scenes("train")[0].own_voxels(0, "none")
    np.save(path, np.zeros((32, 64, 8), np.uint8))
    with pytest.raises(DataError, match=r"the array has the shape \(32, 64, 8\) instead of \(64, 64, 8\)"):
        source_of(tmp_path).scenes("train")[0].own_voxels(0, "none")
