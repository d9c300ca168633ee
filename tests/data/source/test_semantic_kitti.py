"""SemanticKITTI: a small dataset in its layout, literal values of its files, and real samples."""

import shutil

import cv2
import numpy as np
import pytest
import torch
from kitti_files import CAR_ID, OTHER_ID, raw_voxels, write_semantic_kitti

from omniocc.classes import UNKNOWN
from omniocc.data import SceneSource, WindowDataset, collate
from omniocc.data.formats.kitti import (
    SEMANTIC_KITTI,
    SEMANTIC_KITTI_IDS,
    SSCBENCH_IDS,
    camera_of,
    classes_by_id,
    is_first_release,
    read_calibration,
    read_mask,
    read_poses,
)
from omniocc.data.formats.poses import inverse, rigid
from omniocc.data.source import SceneFrames
from omniocc.data.source.completion import voxel_grid
from omniocc.data.source.semantic_kitti import SemanticKITTI
from omniocc.errors import DataError, UserError
from omniocc.geometry import Cylinder
from omniocc.scores import Scores
from omniocc.train.submission import score_files
from rayiou.voxel_iou import voxel_confusion, voxel_scores

SEQUENCES = {"train": ["00"], "val": ["04"], "test": ["08"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_semantic_kitti(tmp_path_factory.mktemp("kitti"))


def source_of(root, **changes):
    options = {"cameras": ["image_2", "image_3"], "image_width": 64, "panorama": (64, 32, 45.0, -45.0), "cache": None}
    source = SemanticKITTI(str(root), SEQUENCES, **options | changes)
    source.prepare()
    return source


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.images(0), scene.cloud(0), scene.world_from_ego


def test_it_keeps_the_contracts(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert (scene.name, len(scene), scene.numbers) == ("08", 2, [0, 5])
    assert scene.world_from_ego[:, 0, 3].tolist() == pytest.approx([0, 5])  # camera 0 moves ahead by 1 m a frame
    assert [image.shape for image in scene.images(1)] == [(16, 64, 3), (16, 64, 3)]
    assert source_of(root, cameras=["image_2"]).scenes("val")[0].rigs[0].names == ("image_2",)
    assert source.spec.classes.names[:3] == ("empty", "car", "bicycle")


def test_labels_follow_the_rule_of_the_benchmark(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    labels = scene.own_voxels(0, "none").numpy()
    raw, invalid = raw_voxels()
    assert set(np.unique(labels)) == {0, 1, 9, 13, UNKNOWN}
    assert (labels[(raw == CAR_ID) & ~invalid] == 1).all()  # a moving car is a car
    assert (labels[raw == OTHER_ID] == UNKNOWN).all()
    assert (labels[invalid] == UNKNOWN).all()
    assert ((labels == 0) == ((raw == 0) & ~invalid)).all()
    hidden = scene.own_voxels(0, "unobserved").numpy()
    assert (hidden[labels != 0] == labels[labels != 0]).all()
    with pytest.raises(ValueError, match="there is no mask of what cameras see"):
        source.labels(source.grid, "unseen")


def test_sequences_with_secret_labels_can_be_predicted_but_not_scored(tmp_path):
    root = write_semantic_kitti(tmp_path, frames=2)
    for path in (root / "sequences" / "08" / "voxels").glob("*.label"):
        path.unlink()
    source = source_of(root)
    scene = source.scenes("test")[0]
    assert scene.numbers == [0, 5]  # those with occupied voxels
    assert scene.own_voxels(0, "none") is None
    assert scene.benchmark(0) is None
    assert source.labels(source.grid, "none").read(scene, 0) is None
    with pytest.raises(UserError, match="scene '08' has no labels here"):
        score_files(source, tmp_path)


def test_what_is_missing_is_listed_at_once_and_labels_are_part_of_the_fingerprint(tmp_path):
    root = write_semantic_kitti(tmp_path, frames=1)
    before = source_of(root).fingerprint
    secret = root / "sequences" / "08" / "voxels" / "000000.label"
    content = secret.read_bytes()
    secret.unlink()
    assert source_of(root).fingerprint != before
    secret.write_bytes(content)
    assert source_of(root).fingerprint == before
    (root / "sequences" / "04" / "poses.txt").unlink()
    (root / "sequences" / "00" / "voxels" / "000000.label").unlink()
    with pytest.raises(DataError) as caught:
        source_of(root)
    first, second = str(caught.value).splitlines()
    assert first.endswith("00/voxels: there are no *.label files, from which training and validation learn")
    assert second.endswith("poses.txt is missing: unpack SemanticKITTI's archive of labels into data.source.root")


def test_numbers_of_sequences_may_be_numbers(root):
    source = SemanticKITTI(
        str(root), {"train": [0], "val": [4], "test": [8]}, ["image_2"], 64, (64, 32, 45.0, -45.0), None
    )
    assert [scene.name for scene in source.scenes("test")] == ["08"]


def test_points_fall_on_the_voxels_and_pixels_that_show_them(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    cloud = scene.cloud(0)
    cells, inside = source.grid.index(torch.from_numpy(cloud.points_m))
    found = scene.own_voxels(0, "none")[tuple(cells[inside].T)]
    same = found == torch.from_numpy(cloud.labels)[inside]
    assert set(cloud.labels) == {9, 13}
    assert same.float().mean() > 0.9
    pixels, ranges = scene.pixel_labels(0)[0], scene.camera_range_m(0)[0]
    height = len(pixels)
    assert set(np.unique(pixels[: height // 2 - 2])) <= {13, UNKNOWN}  # above the horizon there are walls alone
    assert (pixels[-3:] == 9).sum() > 5
    assert np.nanmax(ranges) > 25
    scan = scene.lidar(0)
    np.testing.assert_allclose(scan.directions * scan.range_m[:, None], cloud.points_m, atol=1e-4)


def test_scores_are_on_its_own_voxels_and_nearer_parts(root):
    source = source_of(root)
    grid = Cylinder((16, 24, 8), (0.0, 32.0), (-2.8, 3.6))
    data = WindowDataset(source.scenes("test"), source.labels(grid, "none"), 1, own_rays=True)
    batch = collate([data[0], data[1]])
    scores, exact = Scores(grid, source.spec), Scores(source.grid, source.spec)
    scores.update(batch.voxels.masked_fill(batch.voxels == UNKNOWN, 0), batch)
    exact.update(batch.own_voxels.masked_fill(batch.own_voxels == UNKNOWN, 0), batch)
    found, best = scores.compute(), exact.compute()
    parts = ("voxel/iou", "voxel_12.8m/iou", "voxel_25.6m/miou", "rayiou", "rayiou_12.8-25.6m", "lidar/rayiou")
    assert set(parts) <= set(found)
    assert [float(best[key]) for key in parts[:4]] == [1.0] * 4
    assert 0 < found["voxel/iou"] < 1


def test_submissions_hold_the_ids_of_the_devkit(root, tmp_path):
    scene = source_of(root).scenes("test")[0]
    assert scene.prediction_file(1) == "sequences/08/predictions/000005.label"
    classes = np.arange(np.prod(voxel_grid().shape)).reshape(voxel_grid().shape) % 20
    path = tmp_path / "a.label"
    scene.write_prediction(path, classes.astype(np.uint8))
    ids = np.fromfile(path, "<u2")
    inverse_map = [0, 10, 11, 15, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 70, 71, 72, 80, 81]
    assert ids[:20].tolist() == inverse_map
    np.testing.assert_array_equal(scene.read_prediction(path), classes)


def png(width, height):
    return cv2.imencode(".png", np.full((height, width, 3), 90, np.uint8))[1].tobytes()


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("voxels/000000.label", b"1234", r"sequence.*|scene '00', frame 0: .*000000\.label: the file has 4 bytes"),
        ("voxels/000000.invalid", b"1234", r"000000\.invalid: the file has 4 bytes instead of 262,144 or 2,097,152"),
        ("voxels/000000.invalid", None, r"frame 0: .*000000\.invalid: the file is missing"),
        ("voxels/000000.label", np.full(2_097_152, 47, "<u2").tobytes(), r"class ids \[47\] are not in"),
        ("velodyne/000000.bin", b"12345", r"frame 0: .*000000\.bin: the file has 5 bytes"),
        ("labels/000000.label", b"1234", r"000000\.label has labels of 1 points, but velodyne/000000\.bin has 1"),
        ("image_2/000000.png", b"no image", r"000000\.png: the file is no image"),
        ("image_2/000000.png", png(1, 1), r"000000\.png: the image has 1x1 px, but calib\.txt has its middle near"),
        ("image_2/000000.png", png(248, 37), r"000000\.png: the image has 248x37 px, but calib\.txt has its middle"),
        ("velodyne/000000.bin", b"", r"frame 0: .*000000\.bin: the file is empty"),
        ("poses.txt", b"1 0 0 1e300 0 1 0 0 0 0 1 0\n", r"poses\.txt, line 1: the pose: its position is 1e\+300 m"),
        ("calib.txt", b"P2: 1_0 0 0 0 0 1 0 0 0 0 1 0\n", r"calib\.txt, line 1: 'P2' are not 12 numbers"),
        ("poses.txt", b"1 0 0\n", r"poses\.txt, line 1: it has 3 numbers"),
        ("poses.txt", b"1 0 0 0 0 1 0 0 0 0 2 0\n", r"poses\.txt, line 1: the pose: the 3x3 part .* is no rotation"),
        ("calib.txt", b"P2: 1 0 0 0 0 1 0 0 0 0 1 0\n" * 2, r"calib\.txt, line 2: 'P2:' stands twice"),
        ("calib.txt", b"P2: 1 2 3\n", r"calib\.txt, line 1: 'P2' are not 12 numbers"),
        ("calib.txt", b"P2: 1 0 0 0 0 1 0 0 0 0 1 0\n", r"calib\.txt: the line 'Tr:' is missing; take calib"),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, file, content, message):
    root = write_semantic_kitti(tmp_path, frames=1)
    path = root / "sequences" / "00" / file
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises((DataError, ValueError), match=message):
        read_all(root)


def test_a_wrong_root_lists_what_it_expected(tmp_path):
    with pytest.raises(DataError, match="sequences not found, it holds nothing; give the folder"):
        source_of(tmp_path)
    root = write_semantic_kitti(tmp_path, frames=1)
    shutil.rmtree(root / "sequences" / "04" / "image_3")
    with pytest.raises(DataError, match=r"04/image_3 is missing: unpack KITTI odometry's archive of colour images"):
        source_of(root)


def test_the_first_release_is_found_and_moved_down(tmp_path):
    root = write_semantic_kitti(tmp_path, frames=1, first_release=True)
    with pytest.warns(UserWarning, match="first release, one cell too high"):
        grid = source_of(root).grid
    assert grid == voxel_grid(first_release=True)
    assert grid.height_m == pytest.approx((-2.2, 4.2))
    assert voxel_grid().height_m == pytest.approx((-2.0, 4.4))


@pytest.mark.filterwarnings("ignore:.*first release")
def test_on_the_first_release_submissions_of_both_releases_are_read_and_todays_is_written(tmp_path, capsys):
    """The voxels of the first release lie one cell too high: what is compared with today's is written one lower."""
    source = source_of(write_semantic_kitti(tmp_path / "kitti", frames=2, first_release=True))
    todays = raw_voxels()[0]
    todays[todays == OTHER_ID] = 0
    (scene,) = source.scenes("test")
    scores = {}
    for name, cells in (("today", todays), ("first", np.roll(todays, 1, axis=2))):
        for frame in range(2):
            path = tmp_path / name / scene.prediction_file(frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(cells.tobytes())
        scores[name] = score_files(source, tmp_path / name)[0]
        release = {"today": "today's release", "first": "the first release"}[name]
        assert capsys.readouterr().out.startswith(
            f"predictions: class 10 is car, as in the dataset's files; cells lie as in {release} of the voxels\n"
        )
    assert {found["test/voxel/iou"] for found in scores.values()} == {1.0}
    mine = scene.own_voxels(0, "none").numpy()
    scene.write_prediction(tmp_path / "mine.label", np.where(mine == UNKNOWN, 0, mine))
    written = np.fromfile(tmp_path / "mine.label", "<u2").reshape(todays.shape)
    assert (written > 0)[50:70, 120:130, 3:9].all()
    assert not written[50:70, 120:130, 9].any()
    np.testing.assert_array_equal(scene.read_prediction(tmp_path / "mine.label"), np.where(mine == UNKNOWN, 0, mine))


def test_submissions_in_the_numbers_of_training_are_read_too(root, tmp_path, capsys):
    source = source_of(root)
    (scene,) = source.scenes("test")
    for frame in range(2):
        path = tmp_path / scene.prediction_file(frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        truth = scene.own_voxels(frame, "none").numpy()
        np.where(truth == UNKNOWN, 0, truth).astype("<u2").tofile(path)
    assert score_files(source, tmp_path)[0]["test/voxel/miou"] == 1
    assert capsys.readouterr().out.startswith("predictions: class 1 is car, as in training\n")
    np.full(2_097_152, 20, "<u2").tofile(path)  # a class after the last of training, and 'other vehicle' in the files
    with pytest.raises(DataError, match=r"000000\.label: the class ids \[9\] are not in .* has 0, 1, 10, 11"):
        score_files(source, tmp_path)


def test_rays_that_did_not_come_back_are_no_points_whatever_their_label(tmp_path):
    root = write_semantic_kitti(tmp_path, frames=1)
    whole = source_of(root).scenes("train")[0]
    before, folder = whole.cloud(0), root / "sequences" / "00"
    rows = np.fromfile(folder / "velodyne" / "000000.bin", "<f4").reshape(-1, 4)
    ids = np.fromfile(folder / "labels" / "000000.label", "<u4")
    lost = np.array([[0, 0, 0, 0.5], [np.nan, 1, 1, 0], [np.inf, 0, 0, 0]], "<f4")
    np.insert(rows, [0, 5, 7], lost, axis=0).tofile(folder / "velodyne" / "000000.bin")
    np.insert(ids, [0, 5, 7], [9999, 9999, 0]).astype("<u4").tofile(folder / "labels" / "000000.label")
    after = whole.cloud(0)
    np.testing.assert_array_equal(after.points_m, before.points_m)
    np.testing.assert_array_equal(after.labels, before.labels)
    assert np.isfinite(whole.lidar(0).directions).all()


def test_bits_are_read_as_the_devkit_does(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes([0x80, 0x01, 0xD0]) + bytes(262_141))
    bits = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 1, 0, 0, 0, 0]
    assert read_mask(path).reshape(-1)[:24].astype(int).tolist() == bits
    centers = voxel_grid().centers(torch.float64).reshape(-1, 3)
    for index, center in {
        0: (0.1, -25.5, -1.9),
        1: (0.1, -25.5, -1.7),
        32: (0.1, -25.3, -1.9),
        8192: (0.3, -25.5, -1.9),
        2_097_151: (51.1, 25.5, 4.3),
    }.items():
        assert centers[index].tolist() == pytest.approx(center)


CALIBRATIONS = {
    "00": (
        "P2: 718.856 0 607.1928 45.38225 0 718.856 185.2157 -0.1130887 0 0 1 0.003779761\n"
        "Tr: 4.276802385584e-04 -9.999672484946e-01 -8.084491683471e-03 -1.198459927713e-02 "
        "-7.210626507497e-03 8.081198471645e-03 -9.999413164504e-01 -5.403984729748e-02 9.999738645903e-01 "
        "4.859485810390e-04 -7.206933692422e-03 -2.921968648686e-01\n",
        (0.287991266, 0.048538410, -0.056858719),
        {
            (10.1, 0.1, -1.5): (604.587603, 285.681122),
            (20.1, 5.1, -0.1): (424.253168, 183.078955),
            (51.1, -25.5, 4.3): (968.755794, 115.414930),
        },
    ),
    "08": (
        "P2: 707.0912 0 601.8873 46.88783 0 707.0912 183.1104 0.1178601 0 0 1 0.006203223\n\n"
        "Tr: -1.857739385241e-03 -9.999659513510e-01 -8.039975204516e-03 -4.784029760483e-03 -6.481465826011e-03 "
        "8.051860151134e-03 -9.999466081774e-01 -7.337429464231e-02 9.999773098287e-01 -1.805528627661e-03 "
        "-6.496203536139e-03 -3.339968064433e-01\n",
        (0.327405706, 0.056255190, -0.076487210),
        {
            (10.1, 0.1, -1.5): (598.240119, 281.454925),
            (20.1, 5.1, -0.1): (420.129939, 180.819439),
            (51.1, -25.5, 4.3): (955.868645, 114.737486),
        },
    ),
}


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_the_left_camera_sees_points_where_the_files_say(tmp_path, name):
    text, center, seen = CALIBRATIONS[name]
    (tmp_path / "calib.txt").write_text(text)
    k, pose = camera_of(read_calibration(tmp_path / "calib.txt"), 2)
    assert pose[:3, 3] == pytest.approx(center, abs=2e-6)
    for point, pixel in seen.items():
        x, y, z = (inverse(pose) @ [*point, 1])[:3]
        assert (k[0, 0] * x / z + k[0, 2], k[1, 1] * y / z + k[1, 2]) == pytest.approx(pixel, abs=2e-3)
    with pytest.raises(ValueError, match="there is no camera 5"):
        camera_of(read_calibration(tmp_path / "calib.txt"), 5)


def test_scores_are_those_of_the_official_evaluation():
    """The confusion of all voxels that are not ignored (evaluate_completion.py), written out in float64."""
    generator = torch.Generator().manual_seed(0)
    truth = torch.randint(0, 20, (2, 8, 8, 4), generator=generator, dtype=torch.uint8)
    truth[torch.rand(truth.shape, generator=generator) < 0.2] = 255
    wrong = torch.randint(0, 20, truth.shape, generator=generator, dtype=torch.uint8)
    wrong = torch.where(torch.rand(truth.shape, generator=generator) < 0.6, truth, wrong).masked_fill(truth == 255, 3)
    kept = truth != 255
    confusion = np.zeros((20, 20), np.float64)
    np.add.at(confusion, (wrong[kept].long().numpy(), truth[kept].long().numpy()), 1)
    hits = np.diag(confusion)
    ious = hits / (confusion.sum(0) + confusion.sum(1) - hits)
    completion = confusion[1:, 1:].sum() / (confusion.sum() - confusion[0, 0])
    names = {row.id: row.name for row in SEMANTIC_KITTI.rows[1:]}
    scores = voxel_scores(voxel_confusion(wrong, truth, kept, 20), 0, names)
    assert float(scores["miou"]) == pytest.approx(ious[1:].mean(), abs=1e-12)
    assert float(scores["iou"]) == pytest.approx(completion, abs=1e-12)


def test_the_tables_of_classes_are_those_of_the_devkits():
    kitti, bench = classes_by_id(SEMANTIC_KITTI_IDS), classes_by_id(SSCBENCH_IDS)
    assert {raw: int(kitti[raw]) for raw in (0, 1, 13, 16, 60, 81, 252, 255, 259)} == {
        0: 0,
        1: 255,
        13: 5,
        16: 5,
        60: 9,
        81: 19,
        252: 1,
        255: 8,
        259: 5,
    }
    assert {raw: int(bench[raw]) for raw in (0, 1, 31, 52, 71, 72, 99, 253, 255)} == {
        0: 0,
        1: 255,
        31: 255,
        52: 17,
        71: 255,
        72: 14,
        99: 18,
        253: 255,
        255: 255,
    }
    assert kitti[47] == bench[47] == -1


@pytest.mark.parametrize(("frame", "counts"), [(0, (11_677, 531_780, 1_416_108)), (5, (11_844, 605_465, 1_402_580))])
def test_real_masks_have_the_published_counts(samples, frame, counts):
    stem = samples / "semantickitti_mini" / "sequences" / "00" / "voxels" / f"{frame:06d}"
    masks = [read_mask(stem.with_suffix(f".{kind}")) for kind in ("bin", "invalid", "occluded")]
    assert tuple(int(mask.sum()) for mask in masks) == counts
    if frame == 0:
        per_layer = [
            0,
            1312,
            2209,
            1318,
            784,
            554,
            598,
            655,
            770,
            565,
            487,
            558,
            523,
            451,
            383,
            220,
            130,
            90,
            44,
            23,
            3,
        ]
        assert masks[0].sum((0, 1))[:21].tolist() == per_layer
        assert np.argwhere(masks[0])[:5].tolist() == [[0, 79, z] for z in (4, 6, 7, 8, 9)]


def test_a_real_scan_hits_the_real_voxels_of_the_first_release(samples):
    folder = samples / "semantickitti_mini" / "sequences" / "00"
    hit = read_mask(folder / "voxels" / "000000.bin")
    assert is_first_release(hit[None])
    points = torch.from_numpy(np.fromfile(folder / "velodyne" / "000000.bin", "<f4").reshape(-1, 4)[:, :3].copy())
    labelled = (np.fromfile(folder / "labels" / "000000.label", "<u4") & 0xFFFF) != 0
    shares = {}
    for first_release in (True, False):
        cells, inside = voxel_grid(first_release).index(points[torch.from_numpy(labelled)])
        found = np.zeros_like(hit)
        found[tuple(cells[inside].T.numpy())] = True
        shares[first_release] = (found & hit).sum() / hit.sum()
    assert shares[True] > 0.999
    assert shares[False] < 0.5


def test_real_poses_begin_at_the_origin_and_go_ahead(samples):
    calibration = read_calibration(samples / "voxformer_calib" / "sequences" / "00" / "calib.txt")
    folder = samples / "semantickitti_mini" / "sequences" / "00"
    poses = read_poses(folder / "poses.txt", rigid(calibration["Tr"], "Tr"))
    assert len(poses) == 4541
    assert np.abs(poses[0] - np.eye(4)).max() < 1e-6
    assert poses[5, 0, 3] > 3  # the car drives ahead
    with pytest.raises(DataError, match="the line 'Tr:' is missing"):
        read_calibration(folder / "calib.txt")
