"""WoodScape: a small dataset in its layout, literal values of its lens, and a real sample."""

import json

import cv2
import numpy as np
import pytest
import torch
from dataset_files import FRONT, write_woodscape

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.woodscape import ORIGIN_M, WoodScape, read_calibration
from omniocc.geometry import Cylinder

FRACTIONS = {"train": 0.5, "val": 0.17, "test": 0.33}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_woodscape(tmp_path_factory.mktemp("woodscape"))


def source_of(root):
    source = WoodScape(str(root), FRACTIONS, 64, None)
    source.prepare()
    return source


def test_it_keeps_the_contracts(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    names = {split: [scene.name for scene in source.scenes(split)] for split in ("train", "val", "test")}
    assert names == {
        "train": ["00000_FV", "00001_MVL", "00002_FV"],
        "val": ["00003_MVL"],
        "test": ["00004_FV", "00005_MVL"],
    }
    scene = source.scenes("val")[0]
    assert isinstance(scene, SceneFrames)
    assert (len(scene), scene.rigs[0].names) == (1, ("MVL",))
    labels = source.labels(Cylinder((8, 10, 4)), "none")
    assert labels.read(scene, 0) is labels.benchmark(scene, 0) is None
    assert labels.counts([scene]).sum() == 0


def test_pixels_keep_their_classes(root):
    scene = source_of(root).scenes("train")[0]
    (image,), (labels,) = scene.images(0), scene.pixel_labels(0)
    assert image.shape == (48, 64, 3)
    assert labels.shape == (48, 64)
    assert set(np.unique(labels)) == {1, 6, 255}
    assert (labels[:1] == 255).all()  # void
    assert (labels[4:, :32] == 1).all()
    assert (labels[4:, 32:] == 6).all()
    path = next(root.glob(f"semantic_annotations/gtLabels/{scene.name}.png"))
    cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2])
    with pytest.raises(DataError, match=rf"{path.name}: the image has .* px, but its calibration is for"):
        scene.pixel_labels(0)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ((10, 0, 0), (646.294176560, 378.005483800)),
        ((6, 3, 0), (332.433940366, 447.384901505)),
        ((5, -2, 1), (1019.310281954, 330.536775993)),
        ((3.8, 4, 1.5), (27.054525332, 353.616359115)),
    ],
)
@pytest.mark.parametrize("where", ["written", "real"])
def test_the_front_camera_sees_points_where_the_devkit_does(request, tmp_path, where, point, pixel):
    path = tmp_path / "front.json"
    path.write_text(json.dumps(FRONT))
    if where == "real":
        path = request.getfixturevalue("samples") / "woodscape_front" / "front.json"
    camera, vehicle_from_camera = read_calibration(path)
    seen = torch.linalg.inv(torch.from_numpy(vehicle_from_camera))[:3] @ torch.tensor([*point, 1.0]).double()
    found, valid = camera.project(seen)
    assert valid
    assert found.tolist() == pytest.approx(pixel, abs=1e-4)


def test_the_ego_origin_is_above_the_road(root):
    rig = source_of(root).scenes("train")[0].rigs[0]
    assert rig.ego_from_camera[0, :3, 3].tolist() == pytest.approx([3.7484 - ORIGIN_M[0], 0, 0.66017 - ORIGIN_M[2]])
    assert rig.road_z_m == -ORIGIN_M[2]


CALIBRATION, IMAGE = "calibration/00000_FV.json", "rgb_images/00000_FV.png"
DOT = cv2.imencode(".png", np.zeros((1, 1, 3), np.uint8))[1].tobytes()
LEFT_HANDED = json.dumps(FRONT).replace("translation", "translation used in CARLA").encode()
UNDERSCORE = json.dumps(FRONT | {"intrinsic": FRONT["intrinsic"] | {"k1": "3_39.7"}}).encode()


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (CALIBRATION, b"{}", r"scene '00000_FV', frame 0: .*the key 'intrinsic' is missing"),
        (CALIBRATION, b"{", r"00000_FV\.json: "),
        (CALIBRATION, json.dumps(FRONT).replace("0.5941", "9").encode(), r"extrinsic: .* are no pose"),
        (CALIBRATION, LEFT_HANDED, "left-handed"),
        (CALIBRATION, UNDERSCORE, r"00000_FV\.json: '3_39\.7' is no finite number"),
        (IMAGE, DOT, r"frame 0: .*00000_FV\.png: the image has 1x1 px"),
        (IMAGE, b"no", r"frame 0: .*00000_FV\.png: the file is no image"),
        ("semantic_annotations/gtLabels/00000_FV.png", b"", r"00000_FV\.png: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_woodscape(tmp_path)
    (root / file).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.images(0), scene.pixel_labels(0)


def test_a_wrong_root_lists_what_it_expected(tmp_path):
    with pytest.raises(DataError, match="rgb_images, calibration, semantic_annotations not found"):
        source_of(tmp_path)
