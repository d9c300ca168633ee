"""QuadOcc: a small dataset in the layout that its author's code reads, and pixels by the author's formulas."""

import math

import numpy as np
import pytest
import torch
from rival_files import QUADOCC_FOCAL_PX, write_quadocc

from omniocc.camera import OCam, Panoramic
from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.quadocc import CAMERA_FROM_LIDAR, QuadOcc

SEQUENCES = {"train": ["a"], "val": ["b"], "test": ["c"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_quadocc(tmp_path_factory.mktemp("quadocc"))


def source_of(root, images="unfold", frame_step=5, sequences=SEQUENCES, width=192, pitch_deg=0.0):
    panorama = (64, 32, 45.0, -45.0)
    source = QuadOcc(
        str(root), sequences, images, frame_step, width, panorama, pitch_deg=pitch_deg, road_z_m=-0.8, cache=None
    )
    source.prepare()
    return source


def test_a_small_dataset_is_read(root):
    source = source_of(root)
    scene = source.scenes("test")[0]
    assert isinstance(source, SceneSource)
    assert isinstance(scene, SceneFrames)
    assert (scene.name, scene.numbers) == ("c", ["000000", "000005"])
    assert (scene.world_from_ego == np.eye(4)).all()
    (image,) = scene.images(1)
    assert image.shape == (32, 192, 3)
    assert image.mean() == pytest.approx(100, abs=1)
    assert [part[0] for part in source.spec.benchmark.parts] == ["3.2m", "6.4m"]
    assert source.fingerprint != source_of(root, "raw").fingerprint
    voxels = scene.own_voxels(0, "none")  # in the files 255 is empty, and 0 has no label
    assert voxels[10:25, 2, 7].tolist() == [255, 1, 255, 255, 2, 3, 255, 255, 4, 255, 5, 255, 6, 255, 255]
    assert (voxels[0, :, 1:] == 0).all()
    assert (voxels[:, :, 0] == 3).all()
    assert int((voxels == 255).sum()) == 4 * 5 + 9
    assert scene.benchmark(0).scored is None  # all count that are not 255
    points_m = scene.cloud(0).points_m
    assert len(points_m) == 300  # those at the origin are no hits
    cells, inside = source.grid.flat_index(torch.from_numpy(points_m))
    assert inside.all()
    assert (voxels.flatten()[cells] == 4).all()  # of the building
    columns = np.flatnonzero(np.isfinite(scene.camera_range_m(0)[0]).any(axis=0))
    assert 48 - 16 < columns.min() < columns.max() < 48 + 16  # ahead is a quarter into the unfolded image
    flat, level = points_m, source_of(root, pitch_deg=15.0).scenes("test")[0].cloud(0).points_m
    assert (level[0] - flat[0])[2] < -1.5
    assert np.linalg.norm(level, axis=1) == pytest.approx(np.linalg.norm(flat, axis=1), abs=1e-4)


@pytest.mark.parametrize("point", [(5.0, 0.0, 2.0), (0.0, 5.0, 1.0), (-4.0, -2.0, 1.5), (3.0, -4.0, 0.9)])
def test_a_point_has_the_pixels_of_the_authors_formulas(root, point):
    matrix = np.array(CAMERA_FROM_LIDAR)
    x, y, z = matrix[:, :3] @ np.array(point) + matrix[:, 3]
    raw, unfold = source_of(root, "raw", width=480).rig, source_of(root).rig
    assert isinstance(raw.cameras[0], OCam)
    assert isinstance(unfold.cameras[0], Panoramic)
    found, valid = raw.project(torch.tensor(point, dtype=torch.float64))
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
    found, valid = unfold.project(torch.tensor(point, dtype=torch.float64))
    assert valid.all()
    assert found[0].tolist() == pytest.approx([u - 0.5, v - 0.5], abs=1e-3)


def test_the_annular_lens_sees_from_40_to_100_degrees(root):
    _, valid = source_of(root, "raw", width=480).rig.rays(0)
    across = valid[240, 240:].nonzero()  # from the centre to the right
    expected = [math.radians(deg) * QUADOCC_FOCAL_PX for deg in (40, 100)]
    assert [int(across.min()), int(across.max())] == pytest.approx(expected, abs=1.5)
    assert not valid[0, 0]


VOXELS = "sequences/a/voxel_final/000000.npy"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("PAL_intrinsic_calib_results.txt", "1 2\n", r"calib_results\.txt: 1 lines of numbers"),
        (VOXELS, "no", r"QuadOcc, scene 'a', frame 0: .*000000\.npy: the file is damaged"),
        (VOXELS, np.full((64, 64, 8), 20, np.uint8), r"the class ids \[20\] are not in"),
        ("sequences/a/lidar/000000.pcd", "no", r"frame 0: .*000000\.pcd: the header of a PCD file is missing"),
        ("sequences/a/images_raw/000000.jpg", "no", r"frame 0: .*000000\.jpg: the file is no image"),
        (VOXELS, None, r"sequences/a: there are no voxel_final/\*\.npy"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    path = write_quadocc(tmp_path, frames=1) / file
    if content is None:
        path.unlink()
    else:
        path.write_text(content) if isinstance(content, str) else np.save(path, content)
    with pytest.raises(DataError, match=message):
        read_all(tmp_path)


def read_all(root):
    scene = source_of(root, "raw").scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.cloud(0), scene.images(0)


def test_impossible_options_and_sequences_are_named(root):
    with pytest.raises(ValueError, match="images must be unfold or raw, and frame_step at least 1, got flat and 5"):
        source_of(root, "flat")
    with pytest.raises(DataError, match="d not found, it holds a, b, c; unpack these sequences"):
        source_of(root, sequences=SEQUENCES | {"test": ["d"]})
