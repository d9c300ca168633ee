"""SSCBench-KITTI-360, alone and with the fisheyes of KITTI-360 itself: small datasets in their layouts."""

import shutil

import cv2
import numpy as np
import pytest
import torch
from kitti_files import OTHER_ID, raw_voxels, write_kitti360, write_sscbench

from omniocc.classes import UNKNOWN
from omniocc.data import SceneSource
from omniocc.data.formats.kitti360 import SEQUENCE, match_frames
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.sscbench_kitti360 import SSCBenchKITTI360

SEQUENCES = {"train": ["00"], "val": ["06"], "test": ["09"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_sscbench(tmp_path_factory.mktemp("sscbench"))


@pytest.fixture(scope="module")
def kitti360(tmp_path_factory):
    return write_kitti360(tmp_path_factory.mktemp("kitti360"))


def source_of(root, **changes):
    options = {"kitti360": None, "image_width": 64, "panorama": (64, 32, 45.0, -45.0), "cache": None}
    source = SSCBenchKITTI360(str(root), SEQUENCES, **options | changes)
    source.prepare()
    return source


def test_it_keeps_the_contracts(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert (scene.numbers, len(scene)) == ([0, 5], 2)
    assert scene.world_from_ego[:, 0, 3].tolist() == [0, 5]
    assert [image.shape for image in scene.images(0)] == [(16, 64, 3)]
    assert scene.lidar(0) is scene.erp_range_m(0) is scene.pixel_labels(0) is None
    assert source.spec.classes.num_classes == 19


def test_labels_follow_the_rule_of_the_benchmark(root):
    labels = source_of(root).scenes("train")[0].own_voxels(0, "none").numpy()
    raw, invalid = raw_voxels()
    assert (labels[raw == OTHER_ID] == 18).all()  # labelled cells count although the file calls them invalid
    assert (labels[invalid & (raw == 0)] == UNKNOWN).all()
    assert set(np.unique(labels)) == {0, 1, 7, 11, 18, UNKNOWN}


def test_preprocessed_labels_are_read_where_there_are_no_voxels(tmp_path):
    root = write_sscbench(tmp_path, frames=1, poses=False)
    expected = source_of(root).scenes("train")[0].own_voxels(0, "none")
    folder = root / "preprocess" / "labels" / SEQUENCE.format("00")
    folder.mkdir(parents=True)
    np.save(folder / "000000_1_1.npy", expected.numpy())
    shutil.rmtree(root / "data_2d_raw" / SEQUENCE.format("00") / "voxels")
    scene = source_of(root).scenes("train")[0]
    assert torch.equal(scene.own_voxels(0, "none"), expected)
    assert (scene.world_from_ego == np.eye(4)).all()  # without poses
    np.save(folder / "000000_1_1.npy", expected.numpy()[:2])
    with pytest.raises(DataError, match=r"'00', frame 0: .*_1_1\.npy: the array has the shape \(2, 256, 32\)"):
        scene.own_voxels(0, "none")


def test_the_fisheyes_of_kitti360_are_found_by_their_images(root, kitti360, tmp_path):
    source = source_of(root, kitti360=str(kitti360), cache=str(tmp_path))
    scene = source.scenes("train")[0]
    assert scene.numbers_of_kitti360 == [100, 105]
    assert [image.shape for image in scene.images(1)] == [(16, 64, 3), (64, 64, 3), (64, 64, 3)]
    rig = scene.rigs[0]
    assert rig.names == ("image_00", "image_02", "image_03")
    # the fisheyes look left and right
    assert rig.ego_from_camera[1, :3, 2].tolist() == pytest.approx([0, 1, 0], abs=0.05)
    assert rig.ego_from_camera[2, :3, 2].tolist() == pytest.approx([0, -1, 0], abs=0.05)
    front, left, _ = rig.masks
    assert front is None
    assert [bool(left[row].any()) for row in (0, 32, 60)] == [True, True, False]  # the own car is below
    assert rig.cameras[1].max_angle_deg == 97.5
    assert source.fingerprint != source_of(root).fingerprint
    assert np.isfinite(scene.erp_range_m(1)).mean() > 0.05
    assert scene.lidar(1) is None


def test_frames_are_found_again_when_others_have_labels(kitti360, tmp_path):
    root = write_sscbench(tmp_path / "a", frames=2)
    options = {"kitti360": str(kitti360), "cache": str(tmp_path)}
    assert source_of(root, **options).scenes("train")[0].numbers_of_kitti360 == [100, 105]
    (root / "data_2d_raw" / SEQUENCE.format("00") / "voxels" / "000000.label").unlink()
    assert source_of(root, **options).scenes("train")[0].numbers_of_kitti360 == [105]
    (tmp_path / "kitti360-frames-2-00.json").write_text("[1, 2")
    assert source_of(root, **options).scenes("train")[0].numbers_of_kitti360 == [105]


def test_points_of_the_velodyne_are_seen_where_the_devkit_projects_them(root, kitti360, tmp_path):
    rig = source_of(root, kitti360=str(kitti360), cache=str(tmp_path)).scenes("train")[0].rigs[0].resized(1400, 1400)
    points = torch.tensor([(10, 2, -1), (5, 6, 0), (5, -6, 0), (-8, 5, -1.5)], dtype=torch.float64)
    pixels, valid = rig.project(points)
    # u0 = 716.94 px; expected from kitti360scripts with p1, p2
    for camera, point, pixel in (
        (1, 0, (1314.270533, 786.921482)),
        (1, 1, (1037.877169, 722.175870)),
        (2, 2, (383.667197, 715.291003)),
        (1, 3, (300.912238, 790.311115)),
    ):
        assert valid[camera, point]
        assert pixels[camera, point].tolist() == pytest.approx(pixel, abs=0.02)
    front = rig.cameras[0].resized(1408, 376)
    seen, inside = front.project(torch.linalg.inv(rig.ego_from_camera[0])[:3] @ torch.tensor([10.0, 2, -1, 1]).double())
    assert inside
    assert seen.tolist() == pytest.approx((605.134797, 237.678658), abs=0.02)


def remove_images(root, other):
    for file in sorted(other.glob("data_2d_raw/*_0000_sync/image_00/data_rect/*.png"))[3:]:
        file.unlink()


def cut_label(root, other):
    next(root.glob("data_2d_raw/*_0000_sync/voxels/000000.label")).write_bytes(b"1")


def read_all(root, other):
    scene = source_of(root, kitti360=str(other)).scenes("train")[0]
    return scene.rigs, scene.own_voxels(0, "none")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda root, other: shutil.rmtree(root / "data_2d_raw"), "data_2d_raw not found"),
        (lambda root, other: shutil.rmtree(other / "calibration"), "calibration not found"),
        (lambda root, other: (other / "calibration/calib_cam_to_velo.txt").write_text("1 2"), "12 numbers is missing"),
        (remove_images, r"000005\.png: the same image is not in"),
        (cut_label, r"SSCBench-KITTI-360, scene '00', frame 0: .*the file has 1 bytes instead of 4,194,304"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, change, message):
    root, other = write_sscbench(tmp_path / "a"), write_kitti360(tmp_path / "b")
    change(root, other)
    with pytest.raises(DataError, match=message):
        read_all(root, other)


def test_frames_of_a_slow_car_are_not_taken_for_earlier_ones(tmp_path):
    """A smooth picture that moves little from frame to frame; theirs are copies of every fifth."""
    columns = np.arange(1600) / 1600
    for number in range(31):
        grey = (120 + 100 * np.sin(9 * (columns[2 * number : 2 * number + 1408])))[None].repeat(376, 0)
        cv2.imwrite(str(tmp_path / f"{number:04d}.png"), grey.astype(np.uint8))
    ours = sorted(tmp_path.glob("*.png"))
    assert match_frames(ours[::5], ours, "frames") == list(range(0, 31, 5))
    assert match_frames([ours[3], ours[30]], ours, "frames") == [3, 30]
