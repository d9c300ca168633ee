"""KITTI-360: a small dataset in its layout, literal values of its calibration, and real samples."""

import cv2
import numpy as np
import pytest
import torch
from kitti_files import WALL_M, write_calibration, write_kitti360

from omniocc.camera import Rig
from omniocc.data import SceneSource
from omniocc.data.formats.kitti360 import FLIP, rectified, velodyne_pose
from omniocc.data.source import SceneFrames
from omniocc.data.source.kitti360 import KITTI360, ORIGIN_M, centered
from omniocc.errors import DataError
from omniocc.geometry import Cuboid

SEQUENCES = {"train": ["00"], "val": ["06"], "test": ["09"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_kitti360(tmp_path_factory.mktemp("kitti360"))


def source_of(root, **changes):
    options = {
        "cameras": ["image_02", "image_03"],
        "frame_step": 5,
        "accumulate": 2,
        "volume": None,
        "masks": [],
        "image_width": 64,
        "panorama": (64, 32, 45.0, -45.0),
        "cache": None,
    }
    source = KITTI360(str(root), SEQUENCES, **options | changes)
    source.prepare()
    return source


def test_it_keeps_the_contracts_and_joins_frames_by_number(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    scene = source.scenes("train")[0]
    assert isinstance(scene, SceneFrames)
    # of 12 frames the second has no pose; of the other 11 every fifth is taken
    assert len(scene) == len(scene.world_from_ego) == len(scene.rigs) == 3
    assert source.index.read("00").numbers[:3].tolist() == [100, 102, 103]
    assert np.diff(scene.world_from_ego[:, 0, 3]).tolist() == pytest.approx([6, 5])  # frames 100, 106, 111
    assert [image.shape for image in scene.images(2)] == [(64, 64, 3)] * 2
    assert scene.pixel_labels(0) is scene.lidar(0) is None
    assert source_of(root, frame_step=1).fingerprint != source.fingerprint


def test_the_cameras_are_where_the_calibration_says(root):
    rigs = {
        names: source_of(root, cameras=list(names)).rig
        for names in (
            ("image_00", "image_01", "image_02", "image_03"),
            ("image_02", "image_03"),
        )
    }
    four, two = rigs.values()
    # the origin does not depend on which cameras are used; it is the mean of all four
    torch.testing.assert_close(four.ego_from_camera[2:], two.ego_from_camera)
    assert four.ego_from_camera[:, :3, 3].mean(0).tolist() == pytest.approx([0, 0, 0], abs=1e-4)
    left = two.ego_from_camera[0, :3, 3] + torch.tensor(ORIGIN_M)
    assert left.tolist() == pytest.approx([0.726404, 0.149966, 1.06864], abs=1e-5)
    assert two.ego_from_camera[0, :3, 2].tolist() == pytest.approx([-0.03075, 0.99947, -0.01018], abs=1e-4)


def test_scans_become_ranges_and_votes(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    cloud = scene.cloud(1)
    # walls to both sides of the velodyne, which is 1.73 m above the road
    side = cloud.points_m[np.abs(cloud.points_m[:, 2]) < 0.5]
    assert np.abs(np.abs(side[:, 1] - cloud.origin_m[1]) - WALL_M).max() < 0.5
    panorama = scene.erp_range_m(1)
    assert 0.05 < np.isfinite(panorama).mean() < 0.6
    left, right = scene.camera_range_m(1)
    assert 3 < np.nanmin(left) < WALL_M
    assert np.isfinite(right).sum() > 20
    assert len(scene.points(1).points_m) == 5 * len(cloud.points_m)
    assert len(scene.points(0).points_m) == 3 * len(cloud.points_m)
    grid = Cuboid((20, 20, 8), (-10, 10), (-10, 10), (-2.8, 3.6))
    labels = source.labels(grid, "none")
    cells = labels.read(scene, 1)
    assert set(cells.unique().tolist()) == {0, 1}
    assert cells[12, :, 1].sum() > 10  # the road
    assert labels.benchmark(scene, 1) is None
    assert labels.counts([scene]).shape == (2, 20, 20, 8)
    unobserved = source.labels(grid, "unobserved").read(scene, 1)
    assert (unobserved == 255).any()
    with pytest.raises(ValueError, match="unseen: there is no mask"):
        source.labels(grid, "unseen")


def test_the_calibration_gives_the_poses_of_the_devkit(tmp_path):
    write_calibration(tmp_path / "calibration")
    np.testing.assert_allclose(
        velodyne_pose(tmp_path / "calibration")[:3],
        (
            (0.999929063, 0.0057743, 0.010417564, 0.771049336),
            (0.005805356, -0.999978788, -0.002953306, 0.298541436),
            (0.01040029, 0.003013574, -0.999941374, -0.836280219),
        ),
        atol=2e-6,
    )
    _, pose = rectified(tmp_path / "calibration", "image_00")
    np.testing.assert_allclose(
        pose[:3, :3],
        (
            (0.037793348, -0.101579352, 0.994109107),
            (0.999284179, 0.00190333, -0.037795329),
            (0.001946805, 0.994825851, 0.101577759),
        ),
        atol=2e-6,
    )
    other = rectified(tmp_path / "calibration", "image_01")[1]
    assert (np.linalg.inv(pose) @ other)[:3, 3] == pytest.approx((0.594183404, 0, 0), abs=1e-4)
    assert (FLIP @ pose)[2, 2] < 0  # it looks down


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("calibration/calib_cam_to_pose.txt", "image_00: 1 2 3\n", r"the line 'image_00' of 12 numbers is missing"),
        ("calibration/calib_cam_to_velo.txt", "1 2 3\n", "the line '' of 12 numbers"),
        ("calibration/perspective.txt", "R_rect_00: a b\n", "line 1: the values of 'R_rect_00' are no numbers"),
        ("calibration/perspective.txt", "R_rect_00: 1_0 0 0\n", "line 1: the values of 'R_rect_00' are no numbers"),
        ("data_poses/2013_05_28_drive_0000_sync/poses.txt", "² 1 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: '²' is"),
        ("data_poses/2013_05_28_drive_0000_sync/poses.txt", "100 1 0 0\n", r"poses\.txt, line 1: it has 3 numbers"),
        (
            "data_poses/2013_05_28_drive_0000_sync/poses.txt",
            "100 1 0 0 0 0 1 0 0 0 0 1 0\n" * 2,
            r"poses\.txt, line 2: '100' is",
        ),
        (
            "data_poses/2013_05_28_drive_0000_sync/poses.txt",
            " ".join(["1"] * 12) + "\n" + " ".join(["1"] * 14),
            r"poses\.txt, line 1: it has 11 numbers",
        ),
        ("calibration/perspective.txt", "R_rect_00: 1\nR_rect_00: 2\n", "line 2: the line 'R_rect_00' stands twice"),
        (
            "data_3d_raw/2013_05_28_drive_0000_sync/velodyne_points/data/0000000100.bin",
            "12345",
            r"KITTI-360, scene '00', frame 0: .*0000000100\.bin: the file has 5 bytes",
        ),
        (
            "data_2d_raw/2013_05_28_drive_0000_sync/image_02/data_rgb/0000000100.png",
            "no image",
            r"frame 0: .*0000000100\.png: the file is no image",
        ),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_kitti360(tmp_path)
    (root / file).write_text(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root, cameras=["image_00", "image_02"]).scenes("train")[0]
    return scene.images(0), scene.cloud(0)


def test_a_wrong_root_lists_what_it_expected(tmp_path):
    with pytest.raises(DataError, match="calibration, data_2d_raw, data_3d_raw, data_poses not found"):
        source_of(tmp_path)


def test_the_real_calibration_is_read(samples, tmp_path):
    folder = samples / "kitti360_calibration_rebuilt" / "calibration"
    write_calibration(tmp_path / "calibration")
    np.testing.assert_allclose(velodyne_pose(folder), velodyne_pose(tmp_path / "calibration"), atol=1e-9)
    assert Rig.load(folder).names == ("image_02", "image_03")


def test_the_own_car_is_masked_where_it_is_in_real_images(samples, root):
    rig = source_of(root).rig.resized(1400, 1400)
    for camera, side in enumerate(("left", "right")):
        outside = np.load(samples / "kitti360_fisheye" / f"mask_{side}_fisheye.npy")
        seen = rig.rays(camera)[1].numpy()
        # the sample masks the own car, not the corners beyond the lens
        assert (seen & outside).sum() / seen.sum() < 0.02
        assert (seen & ~outside).sum() / (~outside).sum() > 0.75


def test_real_ranges_lie_in_the_real_lens(samples):
    ranges = cv2.imread(str(samples / "kitti360_fisheye" / "kitti360_depth.png"), cv2.IMREAD_UNCHANGED)
    outside = np.load(samples / "kitti360_fisheye" / "mask_left_fisheye.npy")
    assert (ranges > 0).sum() == 50_789
    assert (ranges[outside] > 0).sum() < 50


VOLUME = {"shape": [40, 40, 8], "cell_m": 0.8}


def test_the_volume_of_occtrack360_is_centred_and_its_masks_leave_cells_out(root):
    whole = centered([256, 256, 32], 0.2)
    assert np.array(whole.bounds) == pytest.approx(np.array([[-25.6, 25.6], [-25.6, 25.6], [-3.2, 3.2]]))
    source = source_of(root, volume=VOLUME, masks=["field_of_view", "ray_traced"])
    grid = source.spec.benchmark.grid
    assert grid.centers()[20, 20, 4].tolist() == pytest.approx([0.4, 0.4, 0.4])  # half of the cells are behind
    scene = source.scenes("train")[0]
    truth = scene.benchmark(1)
    votes = source_of(root).labels(grid, "none").read(scene, 1)
    assert torch.equal(truth.voxels, votes)
    assert truth.scored.any()
    left = votes[28].nonzero()[:, 0].max()  # the wall to the left, seen; what is beyond it, hidden
    assert truth.scored[28, left].any()
    assert not truth.scored[28, left + 2, 3]
    unseen = source.labels(grid, "unseen").read(scene, 1)
    assert torch.equal(unseen == 255, ~truth.scored)
    assert torch.equal(unseen[truth.scored], votes[truth.scored])


def test_each_mask_counts_alone(root):
    scored = {
        masks: source_of(root, volume=VOLUME, masks=list(masks)).scenes("train")[0].benchmark(1).scored
        for masks in [("field_of_view",), ("ray_traced",), ("field_of_view", "ray_traced"), ()]
    }
    view, rays, both, none = scored.values()
    assert torch.equal(both, view & rays)
    assert none.all()
    assert (view & ~rays).any()
    assert (rays & ~view).any()
    source = source_of(root, volume=VOLUME, masks=["field_of_view"])
    assert source.fingerprint not in {source_of(root).fingerprint, source_of(root, volume=VOLUME).fingerprint}


def test_unseen_needs_a_volume_and_masks_have_names(root):
    for options in ({}, {"volume": VOLUME}, {"masks": ["ray_traced"]}):
        source = source_of(root, **options)
        with pytest.raises(ValueError, match=r"unseen: there is no mask of what .* or a volume with masks"):
            source.labels(Cuboid((4, 4, 4)), "unseen")
    with pytest.raises(ValueError, match="masks must be of field_of_view, ray_traced, got"):
        source_of(root, masks=["lidar"])
