"""QuadOcc: a small dataset in the layout that its author's code reads, literal values of classes and pixels."""

import math

import numpy as np
import pytest
import torch
from rival_files import QUADOCC_FOCAL_PX, write_quadocc

from omniocc.camera import OCam, Panoramic
from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.quadocc import CAMERA_FROM_LIDAR, GRID, QuadOcc

SEQUENCES = {"train": ["a"], "val": ["b"], "test": ["c"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_quadocc(tmp_path_factory.mktemp("quadocc"))


def source_of(root, images="unfold", frame_step=5, sequences=SEQUENCES, width=192, pitch_deg=0.0):
    source = QuadOcc(str(root), sequences, images, frame_step, width, (64, 32, 45.0, -45.0), pitch_deg, -0.8, None)
    source.prepare()
    return source


def test_it_keeps_the_contracts_and_takes_every_fifth_frame(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert (scene.name, scene.numbers, len(scene)) == ("c", ["000000", "000005"], 2)
    assert (scene.world_from_ego == np.eye(4)).all()
    (image,) = scene.images(1)
    assert image.shape == (32, 192, 3)
    assert image.mean() == pytest.approx(100, abs=1)
    assert [part[0] for part in source.spec.benchmark.parts] == ["3.2m", "6.4m"]
    assert source.fingerprint != source_of(root, "raw").fingerprint
    with pytest.raises(ValueError, match="unseen: there is no mask"):
        source.labels(GRID, "unseen")


def test_255_is_empty_and_0_has_no_label(root):
    scene = source_of(root).scenes("train")[0]
    voxels = scene.own_voxels(0, "none")
    assert voxels[10:25, 2, 7].tolist() == [255, 1, 255, 255, 2, 3, 255, 255, 4, 255, 5, 255, 6, 255, 255]
    assert (voxels[0, :, 1:] == 0).all()
    assert (voxels[:, :, 0] == 3).all()
    assert int((voxels == 255).sum()) == 4 * 5 + 9
    assert scene.benchmark(0).scored is None  # all count that are not 255
    assert torch.equal(scene.own_voxels(0, "unobserved"), voxels)


def test_points_are_in_the_voxels_of_the_building(root):
    cloud = source_of(root).scenes("train")[0].cloud(0)
    assert len(cloud.points_m) == 300  # those at the origin are no hits
    voxels = source_of(root).scenes("train")[0].own_voxels(0, "none")
    cells, inside = GRID.flat_index(torch.from_numpy(cloud.points_m))
    assert inside.all()
    assert (voxels.flatten()[cells] == 4).all()


def in_camera(point):
    """Return a point of the LiDAR in the camera, by the matrix of the authors' code."""
    matrix = np.array(CAMERA_FROM_LIDAR)
    return matrix[:, :3] @ point + matrix[:, 3]


@pytest.mark.parametrize("point", [(5.0, 0.0, 2.0), (0.0, 5.0, 1.0), (-4.0, -2.0, 1.5), (3.0, -4.0, 0.9)])
def test_a_point_has_the_pixels_of_the_authors_formulas(root, point):
    x, y, z = in_camera(np.array(point))
    found, valid = source_of(root, "raw", width=480).rig.project(torch.tensor(point, dtype=torch.float64))
    angle = math.atan2(math.hypot(x, y), z)
    radius = QUADOCC_FOCAL_PX * angle
    column, row = (239.5 + radius * part / math.hypot(x, y) for part in (x, y))  # u follows x and v follows y
    assert math.radians(40) < angle < math.radians(100)
    assert valid.all()
    assert found[0].tolist() == pytest.approx([column, row], abs=1e-3)
    # unfolded: OCamCalib's first axis is that of rows; longitude falls with the column, before the image is flipped
    longitude = math.atan2(x, y) % (2 * math.pi)
    u = 192 - 192 * (2 * math.pi - longitude) / (2 * math.pi)
    v = (50 - math.degrees(math.atan2(z, math.hypot(x, y)))) / 60 * 32
    found, valid = source_of(root).rig.project(torch.tensor(point, dtype=torch.float64))
    assert valid.all()
    assert found[0].tolist() == pytest.approx([u - 0.5, v - 0.5], abs=1e-3)


def test_ahead_is_a_quarter_into_the_unfolded_image_and_the_lens_is_a_ring(root):
    rig = source_of(root).rig
    assert isinstance(rig.cameras[0], Panoramic)
    ranges = source_of(root).scenes("train")[0].camera_range_m(0)[0]
    columns = np.flatnonzero(np.isfinite(ranges).any(axis=0))
    assert 48 - 16 < columns.min() < columns.max() < 48 + 16
    raw = source_of(root, "raw", width=480).rig
    assert isinstance(raw.cameras[0], OCam)
    _, valid = raw.rays(0)
    across = valid[240, 240:]  # from the centre to the right: 40 to 100 degrees
    assert [int(place) for place in (across.nonzero().min(), across.nonzero().max())] == pytest.approx(
        [math.radians(40) * QUADOCC_FOCAL_PX, math.radians(100) * QUADOCC_FOCAL_PX], abs=1.5
    )
    assert not valid[0, 0]


def test_straight_ahead_of_the_lidar_is_below_the_lens_unless_it_looks_down(root):
    ahead = torch.tensor([9.0, 0.0, 0.0], dtype=torch.float64)
    assert not source_of(root).rig.project(ahead)[1]
    level = source_of(root, pitch_deg=15.0)
    pixels, valid = level.rig.project(ahead)
    assert valid
    assert pixels[0, 1] == pytest.approx(32 * 50 / 60 - 0.5, abs=0.4)  # on the horizon
    points_m = level.scenes("train")[0].cloud(0).points_m
    flat = source_of(root).scenes("train")[0].cloud(0).points_m
    assert (points_m[0] - flat[0])[2] < -1.5
    assert np.linalg.norm(points_m, axis=1) == pytest.approx(np.linalg.norm(flat, axis=1), abs=1e-4)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("PAL_intrinsic_calib_results.txt", b"1 2\n", r"calib_results\.txt: 1 lines of numbers"),
        (
            "sequences/a/voxel_final/000000.npy",
            b"no",
            r"QuadOcc, scene 'a', frame 0: .*000000\.npy: the file is damaged",
        ),
        ("sequences/a/lidar/000000.pcd", b"no", r"frame 0: .*000000\.pcd: the header of a PCD file is missing"),
        ("sequences/a/images_raw/000000.jpg", b"no", r"frame 0: .*000000\.jpg: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_quadocc(tmp_path, frames=1)
    (root / file).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root, "raw").scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.cloud(0), scene.images(0)


def test_impossible_ids_options_and_sequences_are_named(tmp_path):
    root = write_quadocc(tmp_path, frames=1)
    np.save(root / "sequences/a/voxel_final/000000.npy", np.full((64, 64, 8), 20, np.uint8))
    with pytest.raises(DataError, match=r"the class ids \[20\] are not in"):
        source_of(root).scenes("train")[0].own_voxels(0, "none")
    with pytest.raises(ValueError, match="images must be unfold or raw, and frame_step at least 1, got flat and 5"):
        source_of(root, "flat")
    with pytest.raises(DataError, match="d not found, it holds a, b, c; unpack these sequences"):
        source_of(root, sequences=SEQUENCES | {"test": ["d"]})
