"""Occ3D-nuScenes: a small dataset in its layout, and real samples of it."""

import json
import pickle
from types import SimpleNamespace
from typing import Generic, Protocol

import numpy as np
import pytest
import torch
from nuscenes_files import BEGIN_US, EARLY_US, RING_M, SPEED_MPS, voxels, write_nuscenes

from omniocc.camera import Pinhole, Rig
from omniocc.classes import UNKNOWN
from omniocc.data import SceneSource, WindowDataset, collate
from omniocc.data.formats.nuscenes import CAMERAS, VALIDATION, KeyFrames, read_key_frames, records
from omniocc.data.formats.poses import quaternion_pose, rigid
from omniocc.data.source import MadeScenes, SceneFrames, VoxelLabels
from omniocc.data.source.occ3d_nuscenes import GRID, ORIGIN_M, Occ3DNuScenes, Occ3DScene, decode_classes, encode_classes
from omniocc.errors import DataError
from omniocc.geometry import Cylinder
from omniocc.metric import RayIoU
from omniocc.scores import Scores
from rayiou.voxel_iou import voxel_confusion, voxel_scores

PANORAMA = (64, 32, 45.0, -45.0)
COARSE = Cylinder((16, 24, 8), (0.0, 32.0), (-2.8, 3.6))


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_nuscenes(tmp_path_factory.mktemp("nuscenes"))


def source_of(root, **changes):
    options = {"image_width": 64, "panorama": PANORAMA, "ego_motion": True, "val_every": 2, "cache": None}
    source = Occ3DNuScenes(str(root), "v1.0-trainval", **options | changes)
    source.prepare()
    return source


def test_whether_its_scenes_are_made_is_known_before_it_is_prepared(root, tmp_path):
    source = Occ3DNuScenes(
        str(root), "v1.0-trainval", image_width=64, panorama=PANORAMA, ego_motion=True, val_every=2, cache=str(tmp_path)
    )
    # isinstance evaluates members of a protocol in an order that differs from run to run, up to the first that lacks
    bases = [base for base in MadeScenes.__mro__ if base not in (Protocol, Generic, object)]
    asked = {name: hasattr(source, name) for base in bases for name in vars(base) if not name.startswith("_")}
    assert asked == dict.fromkeys(("made_here", "planned_rig", "planned", "missing", "made"), False)


def test_it_keeps_the_contracts_and_splits_as_published(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    assert {split: [scene.name for scene in source.scenes(split)] for split in ("train", "val", "test")} == {
        "train": ["scene-0001"],
        "val": ["scene-0002"],
        "test": ["scene-0003"],
    }
    assert source.fingerprint != source_of(root, val_every=3).fingerprint
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert isinstance(source.labels(GRID, "none"), VoxelLabels)
    assert len(scene) == len(scene.rigs) == len(scene.world_from_ego) == 3
    assert sum(last - first + 1 for first, last in VALIDATION) == 150


def test_cameras_are_where_the_car_was_when_they_took_their_images(root):
    moving = source_of(root).scenes("train")[0].rigs[1].ego_from_camera
    mounted = source_of(root, ego_motion=False).scenes("train")[0].rigs
    dilation_behind_m = SPEED_MPS * EARLY_US * 1e-6
    torch.testing.assert_close(
        mounted[0].ego_from_camera[:, 0, 3] - moving[:, 0, 3], torch.full((6,), dilation_behind_m).double()
    )
    front = CAMERAS.index("CAM_FRONT")
    assert mounted[0].ego_from_camera[front, :3, 3].tolist() == pytest.approx([1.6 - ORIGIN_M[0], 0, 1.5 - ORIGIN_M[2]])
    assert all(rig is mounted[0] for rig in mounted)


def test_points_fall_on_the_voxels_and_pixels_that_show_them(root):
    scene = source_of(root).scenes("train")[0]
    cloud = scene.cloud(0)
    place = torch.from_numpy(cloud.points_m)
    cells, inside = GRID.index(place)
    labels = scene.own_voxels(0, "none")
    # the labels' wall is around the ego origin of nuScenes, that of the points around the LiDAR, 0.94 m ahead of it
    ahead = (place[:, 0] + ORIGIN_M[0] - 0.94).hypot(place[:, 1])
    wall = (ahead > RING_M - 0.1) & (place[:, 0].abs() < 1) & (place[:, 2] + ORIGIN_M[2] > 0.1)
    assert inside.all()
    assert wall.sum() > 20
    assert (labels[tuple(cells[wall].T)] == 16).all()
    front = scene.camera_range_m(0)[0]
    assert np.nanmax(front) == pytest.approx(RING_M - 0.3, abs=0.7)
    panorama = scene.erp_range_m(0)
    assert panorama.shape == (32, 64)
    assert 0.05 < np.isfinite(panorama).mean() < 0.5
    assert scene.pixel_labels(0) is None
    assert scene.lidar(0) is None
    scan = scene.scan(0)
    assert set(scan.labels) == {UNKNOWN}
    np.testing.assert_allclose(scan.origins + scan.range_m[:, None] * scan.directions, cloud.points_m, atol=1e-4)
    assert (scan.origins == np.float32(cloud.origin_m)).all()


def test_lidarseg_gives_classes_of_pixels_and_rays(root):
    scene = source_of(root).scenes("train")[0]
    points = len(np.fromfile(scene.root / str(scene.frames.lidar[0]), "<f4")) // 5
    folder = root / "lidarseg" / "v1.0-trainval"
    folder.mkdir(parents=True)
    raw = np.full(points, 28, np.uint8)  # static.manmade
    raw[:5] = 31  # the ego car: none of the classes
    raw.tofile(folder / f"{scene.frames.lidar_tokens[0]}_lidarseg.bin")
    scan = scene.lidar(0)
    assert set(scan.labels[:5]) == {UNKNOWN}
    assert set(scan.labels[5:]) == {16}
    np.testing.assert_allclose(
        scan.origins + scan.directions * scan.range_m[:, None], scene.cloud(0).points_m, atol=1e-4
    )
    assert set(np.unique(scene.pixel_labels(0)[0])) == {16, UNKNOWN}
    with pytest.raises(DataError, match=r"frame 1: .*_lidarseg\.bin: the file is missing"):
        scene.lidar(1)
    raw[7] = 99
    raw.tofile(folder / f"{scene.frames.lidar_tokens[0]}_lidarseg.bin")
    with pytest.raises(DataError, match=r"class ids \[99\]"):
        scene.lidar(0)
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()


def test_masks_make_cells_unknown_or_not_scored(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    free, unobserved, unseen = (scene.own_voxels(0, ignore) for ignore in ("none", "unobserved", "unseen"))
    raw, observed = voxels()
    assert torch.equal(free, torch.from_numpy(decode_classes(raw)))
    assert np.array_equal(encode_classes(free.numpy()), raw)
    assert torch.equal(unobserved == UNKNOWN, torch.from_numpy(~observed))
    assert 0.05 < ((unseen == UNKNOWN) & (unobserved != UNKNOWN)).sum() / observed.sum() < 0.15
    truth = scene.benchmark(0)
    assert torch.equal(truth.scored, unseen != UNKNOWN)
    torch.testing.assert_close(truth.ray_origins.positions_m[:, 0], torch.tensor([0.0, 4.5, 9.0]) + 0.94 - ORIGIN_M[0])


def test_a_model_on_another_grid_is_scored_on_the_voxels_of_the_dataset(root):
    source = source_of(root)
    scenes, labels = source.scenes("test"), source.labels(COARSE, "none")
    data = WindowDataset(scenes, labels, 1)
    batch = collate([data[0], data[1]])
    assert batch.voxels.shape[1:] == COARSE.shape
    assert batch.own_voxels.shape[1:] == GRID.shape
    scores, exact = Scores(COARSE, source.spec), Scores(GRID, source.spec)
    scores.update(batch.voxels.masked_fill(batch.voxels == UNKNOWN, 0), batch)
    exact.update(batch.own_voxels, batch)
    found, best = scores.compute(), exact.compute()
    assert 0 < found["rayiou"] < 0.9
    assert best["rayiou"] == best["voxel/miou"] == 1
    assert {"rayiou_0-20m", "rayiou_20-40m", "rayiou/manmade", "voxel/iou/car"} <= set(found)


def test_counts_are_those_of_the_labels(root):
    source = source_of(root)
    labels = source.labels(GRID, "unobserved")
    counts = labels.counts(source.scenes("train"))
    assert counts.shape == (18, *GRID.shape)
    raw, observed = voxels()
    assert counts[16].sum() == 3 * ((raw == 15) & observed).sum()
    assert counts.sum() == 3 * observed.sum()


def test_the_index_is_read_again_and_tells_when_it_is_damaged(root, monkeypatch):
    source = source_of(root)
    monkeypatch.setattr("omniocc.data.source.occ3d_nuscenes.read_key_frames", None)
    again = source_of(root)
    assert again.fingerprint == source.fingerprint
    assert source_of(root, image_width=32).fingerprint != source.fingerprint


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("gts/scene-0001/scene-0001-0/labels.npz", None, r"'scene-0001', frame 0: .*labels\.npz: the file is missing"),
        (
            "gts/scene-0001/scene-0001-0/labels.npz",
            lambda old: old[:300],
            r"frame 0: .*npz: the file is damaged",
        ),
        (
            "samples/LIDAR_TOP",
            lambda old: old[:-7],
            r"frame 0: .*pcd\.bin: the file has .* bytes instead",
        ),
        ("samples/CAM_FRONT", lambda old: b"no image", r"frame 0: .*jpg: the file is no image"),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, file, change, message):
    root = write_nuscenes(tmp_path, ("scene-0001", "scene-0002", "scene-0003"), frames=1)
    scene = source_of(root).scenes("train")[0]
    path = root / file
    if path.is_dir():
        path = next(path.glob("scene-0001-0__*"))
    content = path.read_bytes()
    path.unlink()
    if change is not None:
        path.write_bytes(change(content))
    with pytest.raises(DataError, match=message):
        scene.own_voxels(0, "none"), scene.images(0), scene.cloud(0)


@pytest.mark.parametrize("key", ["semantics", "pred"])
@pytest.mark.parametrize(("wrong", "dtype"), [(-1, "i8"), (18, "u1"), (3.5, "f4"), (np.nan, "f8")])
def test_labels_and_predictions_are_whole_numbers_from_0_to_17(tmp_path, key, wrong, dtype):
    root = write_nuscenes(tmp_path, ("scene-0001", "scene-0002", "scene-0003"), frames=1)
    scene = source_of(root).scenes("test")[0]
    path = scene.label_file(0)
    content = dict(np.load(path))
    changed = content["semantics"].astype(dtype)
    np.savez(path, **content | {key: changed})
    right = scene.own_voxels(0, "none").numpy() if key == "semantics" else scene.read_prediction(path)
    np.testing.assert_array_equal(right, decode_classes(content["semantics"]))
    changed[3, 4, 5] = wrong
    np.savez(path, **content | {key: changed})
    shown = "the class ids" if float(wrong).is_integer() else "values that are no whole numbers"
    with pytest.raises(DataError, match=rf"labels\.npz: .*{shown}.*{wrong}"):
        scene.own_voxels(0, "none") if key == "semantics" else scene.read_prediction(path)


def test_rays_that_did_not_come_back_are_no_points(tmp_path):
    root = write_nuscenes(tmp_path, ("scene-0001", "scene-0002", "scene-0003"), frames=1)
    scene = source_of(root).scenes("train")[0]
    before, path = scene.cloud(0), root / str(scene.frames.lidar[0])
    rows = np.fromfile(path, "<f4").reshape(-1, 5)
    np.insert(rows, [0, 3], [[0, 0, 0, 7, 1], [np.nan, 0, 0, 7, 1]], axis=0).astype("<f4").tofile(path)
    after = scene.cloud(0)
    np.testing.assert_array_equal(after.points_m, before.points_m)


def twofold(text, **other):
    """Return a table with its first record once more, where `other` values may stand in it."""
    rows = json.loads(text)
    return json.dumps([*rows, rows[0] | other])


def first(text, **other):
    """Return a table whose first record has `other` values."""
    rows = json.loads(text)
    return json.dumps([rows[0] | other, *rows[1:]])


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("sample_data", lambda text: text[: len(text) // 2], r"sample_data\.json: the table is cut off"),
        ("ego_pose", lambda text: text.replace("[\n1.0,", "[\n0.4,"), r"ego_pose\.json: record .* are no pose"),
        ("ego_pose", lambda text: "[]", r"ego_pose\.json: the record pose-.* is missing"),
        ("sample_data", lambda text: "[]", r"sample scene-0001-0 has no CAM_FRONT, "),
        ("sample", lambda text: "[]", r"sample\.json: it has no sample of the scenes of scene\.json$"),
        ("scene", lambda text: "[]", r"scene\.json: it has no record of a scene$"),
        ("scene", lambda text: twofold(text), r"scene\.json: there are two records of "),
        (
            "scene",
            lambda text: twofold(text, token="other"),
            r"scene\.json: there are two records of scene 'scene-0001'",
        ),
        ("sample", lambda text: twofold(text), r"sample\.json: there are two records of scene-0001-0"),
        ("ego_pose", lambda text: twofold(text), r"ego_pose\.json: there are two records of pose-"),
        ("sample_data", lambda text: twofold(text, token="other"), r"two records of \('scene-0001-0', 'CAM_FRONT'\)"),
        ("sensor", lambda text: text.replace('"token"', '"token": "a", "token"'), "the key 'token' stands twice"),
        ("sensor", lambda text: text.replace("channel", "chanel"), r"sensor\.json: a record lacks .*'channel'"),
        (
            "sample",
            lambda text: first(text, token=None),
            r"sample\.json: the table is damaged: a record holds .* null: ",
        ),
        ("ego_pose", lambda text: first(text, rotation=None), r"ego_pose\.json: the table is damaged: .* null"),
        ("ego_pose", lambda text: first(text, rotation=[[None] * 4]), r"ego_pose\.json: record .* are no pose"),
        ("sample_data", lambda text: first(text, ego_pose_token=[[]]), r"sample_data\.json: a record lacks a value"),
        ("sample_data", lambda text: "[7]", r"sample_data\.json: the table is damaged: a record holds no value"),
        (
            "calibrated_sensor",
            lambda text: first(text, camera_intrinsic=[]),
            r"calibrated_sensor\.json: a record lacks .*camera_intrinsic of .* is no 3x3 matrix",
        ),
        ("sample", lambda text: "[" * 100_000, r"sample\.json: the table is damaged"),
    ],
)
def test_a_damaged_table_is_one_line(tmp_path, table, change, message):
    root = write_nuscenes(tmp_path, ("scene-0001",), frames=1)
    path = root / "v1.0-trainval" / f"{table}.json"
    path.write_text(change(path.read_text()))
    with pytest.raises(DataError, match=message):
        source_of(root)
    assert not (root / "omniocc" / "index-v1.0-trainval").exists()


def test_a_wrong_root_lists_what_it_expected_and_found(tmp_path):
    (tmp_path / "sweeps").mkdir()
    with pytest.raises(DataError, match=r"v1\.0-trainval, samples, gts not found, it holds sweeps; unpack"):
        source_of(tmp_path)


def test_tables_larger_than_a_chunk_are_read_whole(root, monkeypatch):
    whole = read_key_frames(root / "v1.0-trainval")
    monkeypatch.setattr("omniocc.data.formats.nuscenes.CHUNK_BYTES", 37)
    for mine, theirs in zip(read_key_frames(root / "v1.0-trainval")["scene-0003"], whole["scene-0003"], strict=True):
        assert np.array_equal(mine, theirs)
    assert whole["scene-0003"].time_us.tolist() == [BEGIN_US, BEGIN_US + 500_000, BEGIN_US + 1_000_000]


def test_the_lyft_tables_are_read_as_well(samples):
    folder = samples / "lyft_tables" / "v1.01-train" / "v1.01-train"
    tables = {name: json.loads((folder / f"{name}.json").read_text()) for name in ("scene", "sample_data", "ego_pose")}
    for name, rows in tables.items():
        assert list(records(folder / f"{name}.json")) == rows


@pytest.fixture
def label(samples):
    content = np.load(samples / "occ3d_nuscenes" / "29796060110c4163b07f06eff4af0753" / "labels.npz")
    return {name: content[name] for name in ("semantics", "mask_lidar", "mask_camera")}


def test_the_real_label_has_the_published_counts(label):
    counts = [169, 82, 0, 974, 1749, 0, 83, 0, 0, 0, 0, 8433, 0, 2610, 1007, 5286, 18699, 600908]
    assert np.bincount(label["semantics"].ravel()).tolist() == counts
    assert np.bincount(decode_classes(label["semantics"]).ravel(), minlength=18).tolist() == [counts[17], *counts[:17]]
    assert (label["mask_lidar"].sum(), label["mask_camera"].sum()) == (56_601, 43_355)


ONE = ((0.985793, 0.0, 1.84019),)
EIGHT = (
    (0.985793, 0, 1.84019),
    (5.24657, -0.078224, 1.911887),
    (9.467206, -0.280781, 1.985268),
    (13.658517, -0.573969, 2.041464),
    (22.112557, -1.49188, 2.161954),
    (26.390237, -2.1845, 2.254673),
    (30.765324, -2.970935, 2.344705),
    (35.120997, -3.813812, 2.443711),
)


@pytest.mark.parametrize(
    ("origins", "change", "expected"),
    [
        (ONE, lambda s, m: s, (1.0, 1.0, 1.0, 1.0)),
        (ONE, lambda s, m: np.roll(s, 1, 0), (0.7618276, 0.7451620, 0.7656230, 0.7746979)),
        (ONE, lambda s, m: np.roll(s, 3, 1), (0.3285660, 0.1692313, 0.3944519, 0.4220149)),
        (ONE, lambda s, m: np.roll(s, 1, 2), (0.5257591, 0.4790558, 0.5255160, 0.5727054)),
        (ONE, lambda s, m: np.where(m, s, 17), (0.9591618, 0.9527974, 0.9599120, 0.9647761)),
        (EIGHT, lambda s, m: np.roll(s, 1, 0), (0.7462102, 0.7270022, 0.7491322, 0.7624963)),
        (EIGHT, lambda s, m: np.where(m, s, 17), (0.9032693, 0.8931333, 0.9050290, 0.9116456)),
    ],
)
def test_rayiou_of_a_real_label_is_that_of_the_public_kernel(label, origins, change, expected):
    """Values of the public script's kernel on this label; it works in float32, so that a few rays may differ."""
    truth = torch.from_numpy(decode_classes(label["semantics"]))[None]
    wrong = torch.from_numpy(decode_classes(change(label["semantics"], label["mask_camera"] == 1)))[None]
    metric = RayIoU(GRID, 18)
    metric.update(wrong, truth, (torch.tensor(origins) - torch.tensor(ORIGIN_M))[None])
    found = metric.compute()
    for key, value in zip(("rayiou", "rayiou@1", "rayiou@2", "rayiou@4"), expected, strict=True):
        assert float(found[key]) == pytest.approx(value, abs=1e-4)


@pytest.mark.parametrize(
    ("change", "camera", "lidar", "everywhere", "occupied"),
    [
        (lambda s, m: np.roll(s, 1, 0), 0.67321426159, 0.65890476353, 0.54609782248, 0.73093568770),
        (
            lambda s, m: np.roll(s, 3, 1),
            0.23465864697,
            0.23257808255,
            0.18588298594,
            0.45712709058,
        ),
        (lambda s, m: np.roll(s, 1, 2), 0.54253256028, 0.53465360257, 0.44792227830, 0.50963374414),
        (lambda s, m: np.where(m, s, 17), 1.0, 0.82365037818, 0.76206105294, 1.0),
        (lambda s, m: np.full_like(s, 17), 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_voxel_scores_of_a_real_label_are_those_published(label, change, camera, lidar, everywhere, occupied):
    truth = torch.from_numpy(decode_classes(label["semantics"]))[None]
    wrong = torch.from_numpy(decode_classes(change(label["semantics"], label["mask_camera"] == 1)))[None]
    masks = [label["mask_camera"], label["mask_lidar"], np.ones_like(label["mask_camera"])]
    for mask, expected in zip(masks, (camera, lidar, everywhere), strict=True):
        confusion = voxel_confusion(wrong, truth, torch.from_numpy(mask == 1)[None], 18)
        scores = voxel_scores(confusion, 0, {k: str(k) for k in range(1, 18)})
        # the published mean is over the classes that occur in the truth
        assert float(scores["miou"]) == pytest.approx(expected, abs=1e-9)
    seen = voxel_scores(
        voxel_confusion(wrong, truth, torch.from_numpy(masks[0] == 1)[None], 18), 0, {k: str(k) for k in range(1, 18)}
    )
    assert float(seen["iou"]) == pytest.approx(occupied, abs=1e-9)


class Restricted(pickle.Unpickler):
    """Reads builtin types and arrays of numpy; whatever else a pickle names is refused."""

    def find_class(self, module, name):
        if module.split(".")[0] in ("numpy", "builtins", "_codecs") and name != "eval":
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name}")


def restricted_pickle(path):
    with path.open("rb") as file:
        return Restricted(file).load()


@pytest.mark.parametrize(
    ("first", "frame", "count", "some"),
    [
        (0, 0, 8, dict(enumerate(EIGHT))),
        (0, 20, 8, {0: (-38.271475, 0.022015, 1.938939), 7: (38.006875, -0.743375, 1.704625)}),
        (0, 39, 8, {0: (-37.204632, 0.519443, 2.351371), 7: (0.985793, 0.0, 1.84019)}),
        (40, 0, 8, {1: (7.92817, -3.091017, 1.891035), 7: (2.310708, -38.62442, 2.329972)}),
        (40, 20, 8, {0: (-5.516706, -33.727669, 1.816533), 7: (37.464498, -1.619778, 1.168821)}),
    ],
)
def test_origins_of_rays_follow_from_real_poses(samples, first, frame, count, some):
    infos = restricted_pickle(samples / "nuscenes_infos_val_mini" / "nuscenes_infos_val_mini_sweep.pkl")["infos"]
    scene = infos[first : first + 40 + (first > 0)]
    poses = {
        name: np.stack([quaternion_pose(i[f"{name}_rotation"], i[f"{name}_translation"], "info") for i in scene])
        for name in ("lidar2ego", "ego2global")
    }
    source = SimpleNamespace(panorama=None, root=".", version="", index=None, image_width=64, ego_motion=True)
    real = Occ3DScene(source, "real")
    none = dict.fromkeys(KeyFrames._fields)
    frames = KeyFrames(**none | {"world_from_ego": poses["ego2global"], "ego_from_lidar": poses["lidar2ego"]})
    real.index = SimpleNamespace(read=lambda name: frames)
    found = real.ray_origins(frame).positions_m.double() + torch.tensor(ORIGIN_M, dtype=torch.float64)
    assert len(found) == count
    for place, expected in some.items():
        assert found[place].tolist() == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(
    ("point", "moved", "mounted"),
    [
        ((15, 2, 0), (639.38645, 625.51842), (634.68645, 627.89052)),
        ((30, -5, 1), (1045.57439, 508.38655), (1048.12993, 507.437)),
    ],
)
def test_a_real_camera_sees_points_where_the_devkit_does(samples, point, moved, mounted):
    info = restricted_pickle(next((samples / "nuscenes_demo").glob("*.pkl")))["data_list"][0]
    camera, lidar = info["images"]["CAM_FRONT"], np.array(info["lidar_points"]["lidar2ego"])
    poses = {
        moved: rigid(lidar @ np.linalg.inv(np.array(camera["lidar2cam"])), "CAM_FRONT"),
        mounted: rigid(np.array(camera["cam2ego"]), "CAM_FRONT"),
    }
    for expected, pose in poses.items():
        k = np.array(camera["cam2img"])
        model = Pinhole(1600, 900, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]))
        rig = Rig((model,), torch.from_numpy(pose)[None], ("CAM_FRONT",))
        pixels, valid = rig.project(torch.tensor([point], dtype=torch.float64))
        assert valid.all()
        assert pixels[0, 0].tolist() == pytest.approx(expected, abs=0.02)
