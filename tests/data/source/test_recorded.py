"""Recorded scenes as a source: which scenes belong to which split, and that they fit together."""

import itertools
import json
import pickle
import shutil
from dataclasses import replace

import fsspec
import pytest
import torch
from fake_scene import FakeWorld

from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data import DataError, Recorded
from omniocc.data.source.recorded import by_fraction, reach_of, split_scenes, votes_of
from omniocc.data.store.meta import RENDERED_REACH_M
from omniocc.geometry import Cylinder

GRID = Cylinder(shape=(4, 6, 2), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6))
PATTERNS = {"train": ["train-*"], "val": ["val-*"], "test": ["test-*"]}
NAMES = ["drive-a", "drive-b", "night-a", "night-b"]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    world = FakeWorld(tmp_path_factory.mktemp("world"), frames=2)
    world.prepare()
    return world


@pytest.fixture
def root(world, tmp_path):
    """Return a folder of scenes that a test may change."""
    shutil.copytree(world.place, tmp_path / "scenes")
    return tmp_path / "scenes"


def record(folder, **changes):
    """Render one more scene below a folder, in a world with other settings, and return its folder."""
    world = FakeWorld(folder / "other", scenes=(0, 0, 1), frames=2)
    for name, value in changes.items():
        setattr(world, name, value)
    world.prepare()
    (scene,) = world.scenes("test")
    return scene.folder


def test_the_scenes_and_labels_are_those_of_the_world_that_recorded_them(world, root):
    source = Recorded(str(root), PATTERNS)
    source.prepare()
    for split in ("train", "val", "test"):
        assert [scene.name for scene in source.scenes(split)] == [scene.name for scene in world.scenes(split)]
    ours, theirs = source.spec, world.spec
    assert (ours.classes, ours.range_edges_m, ours.frame_interval_s, ours.road_z_m) == (
        theirs.classes,
        theirs.range_edges_m,
        theirs.frame_interval_s,
        theirs.road_z_m,
    )
    assert torch.equal(ours.lidar_directions, theirs.lidar_directions)
    scene = source.scenes("train")[0]
    labels, expected = (one.labels(GRID, "none") for one in (source, world))
    for cache in (labels, expected):
        cache.prepare([scene])
    assert torch.equal(labels.read(scene, 1), expected.read(scene, 1))
    assert labels.folder.is_relative_to(root)


def test_other_scenes_have_another_fingerprint_and_other_labels(root, tmp_path):
    before = Recorded(str(root), PATTERNS)
    moved = shutil.copytree(root, tmp_path / "moved")
    same = Recorded(str(moved), PATTERNS)
    assert (same.fingerprint, same.folder.name) == (before.fingerprint, before.folder.name)
    shutil.copytree(record(tmp_path, seed=5), moved / "test-000-again")
    more = Recorded(str(moved), PATTERNS)
    assert more.fingerprint != before.fingerprint
    assert more.folder.name != before.folder.name


def test_splits_can_be_read_from_a_file(root):
    (root / "splits.json").write_text(json.dumps({"train": ["train-000-downtown"], "val": ["val-*"], "test": []}))
    source = Recorded(str(root))
    source.prepare()
    assert [len(source.scenes(split)) for split in ("train", "val", "test")] == [1, 1, 0]
    (root / "splits.json").unlink()
    with pytest.raises(DataError, match=r"splits\.json.*missing.*data\.source\.splits"):
        Recorded(str(root)).prepare()
    (root / "splits.json").write_text("[")
    with pytest.raises(DataError, match=r"splits\.json.*cannot be read"):
        Recorded(str(root)).prepare()


def test_scenes_are_read_from_a_store(root, tmp_path):
    store = fsspec.filesystem("memory")
    store.put(str(root), "/recorded/scenes", recursive=True)
    source = Recorded("memory://recorded/scenes", PATTERNS, cache=str(tmp_path / "cache"))
    source.prepare()
    local = Recorded(str(root), PATTERNS)
    assert source.fingerprint == local.fingerprint
    there, here = source.scenes("test")[0], local.scenes("test")[0]
    assert all((a == b).all() for a, b in zip(there.images(1), here.images(1), strict=True))
    assert source.folder.is_relative_to(tmp_path / "cache")
    with pytest.raises(ValueError, match=r"memory://recorded/scenes.*cache"):
        Recorded("memory://recorded/scenes", PATTERNS)
    store.rm("/recorded", recursive=True)


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"train": ["*"], "val": ["night-c"], "test": []}, r"splits\.val: no scene is called 'night-c'.*'night-"),
        ({"train": ["*"], "val": ["night-a"], "test": []}, r"'night-a' .* both train and val"),
        ({"train": ["*"], "val": []}, r"splits has \['train', 'val'\].*train, val, test"),
        ({"train": 0.5, "val": ["night-a"], "test": 0.1}, "fractions for all splits or for none"),
        ({"train": 0.9, "val": 0.2, "test": 0.1}, "at most 1"),
        ({"train": 0.9, "val": 0.02, "test": 0.02}, r"splits\.val=0\.02: less than one of 4 scenes"),
    ],
)
def test_splits_that_make_no_sense_are_named(splits, message):
    with pytest.raises(DataError, match=message):
        split_scenes(splits, NAMES, "data/recorded")


def test_a_folder_without_scenes_is_named(tmp_path):
    with pytest.raises(DataError, match=r"no recorded scenes"):
        Recorded(str(tmp_path), PATTERNS).prepare()
    with pytest.raises(DataError, match=r"nowhere.*no such folder"):
        Recorded(str(tmp_path / "nowhere"), PATTERNS).prepare()


def test_fractions_assign_every_scene_regardless_of_order():
    names = [f"scene-{k}" for k in range(20)]
    dealt = by_fraction({"train": 0.6, "val": 0.2, "test": 0.2}, names)
    assert [len(dealt[split]) for split in ("train", "val", "test")] == [12, 4, 4]
    assert sorted(itertools.chain(*dealt.values())) == sorted(names)
    assert by_fraction({"train": 0.6, "val": 0.2, "test": 0.2}, names[::-1]) == dealt
    assert dealt["train"] != sorted(names)[:12]


def test_scenes_that_do_not_fit_together_are_named(root, tmp_path):
    shutil.copytree(record(tmp_path, frame_interval_s=0.25), root / "test-001-other")
    with pytest.raises(DataError, match=r"test-001-other.*frame_interval_s.*0\.25.*0\.5.*leave this one out"):
        Recorded(str(root), PATTERNS).prepare()


def test_scenes_may_have_cameras_of_their_own(root, tmp_path):
    rig = Rig.load("pinhole6").resized(32, 18)
    shutil.copytree(record(tmp_path, rig=rig), root / "test-001-other")
    source = Recorded(str(root), PATTERNS)
    source.prepare()
    rigs = [scene.rigs[0] for scene in source.scenes("test")]
    assert rigs[-1] == rig
    assert rigs[0] != rig


def test_a_damaged_scene_is_named(root):
    path = root / "val-000-downtown" / "meta.json"
    path.write_text(path.read_text().replace("Roadline", "Roadlime"))
    with pytest.raises(DataError, match=r"val-000-downtown.*checksum"):
        Recorded(str(root), PATTERNS).prepare()


def test_masks_of_a_rig_file_replace_the_recorded_ones(root, tmp_path):
    plain = Recorded(str(root), PATTERNS)
    rig = plain.scenes("train")[0].rig
    pixels = torch.ones(rig.cameras[0].height, rig.cameras[0].width, dtype=torch.bool)
    pixels[-1] = False
    replace(rig, masks=(pixels,) * len(rig.cameras)).save(tmp_path / "masked.yaml")
    masked = Recorded(str(root), PATTERNS, masks=str(tmp_path / "masked.yaml"))
    assert masked.fingerprint != plain.fingerprint
    assert masked.folder == plain.folder
    for ignore, same in (("none", True), ("unobserved", False)):  # what a camera does not show, it does not observe
        assert (masked.labels(GRID, ignore).folder == plain.labels(GRID, ignore).folder) == same
    assert Recorded(str(root), PATTERNS, panorama=(32, 16, 30.0, -30.0)).fingerprint != plain.fingerprint
    for one in pickle.loads(pickle.dumps(masked.scenes("test")[0])).rigs:  # loader processes get copies
        assert all(torch.equal(mask, pixels) for mask in one.masks)
    replace(rig, masks=(pixels,) * len(rig.cameras), road_z_m=-2.2).save(tmp_path / "exported.yaml")
    exported = Recorded(str(root), PATTERNS, masks=str(tmp_path / "exported.yaml")).scenes("train")[0].rig
    assert exported == masked.scenes("train")[0].rig  # the road is that of the recording
    Rig.load("pinhole6").save(tmp_path / "other.yaml")
    other = Recorded(str(root), PATTERNS, masks=str(tmp_path / "other.yaml"))
    with pytest.raises(DataError, match="its cameras are not those of the rig with masks"):
        other.scenes("train")[0].rig  # noqa: B018


def test_cells_beyond_the_recorded_points_are_unknown_and_not_free(world, root):
    far = Cylinder((20, 8, 2), (0.0, 50.0), (-2.8, 3.6))
    source = Recorded(str(root), PATTERNS)
    scene = source.scenes("test")[0]
    voxels = source.labels(far, "none").read(scene, 0)
    assert torch.equal(voxels == UNKNOWN, (far.centers().abs() > 26)[..., :2].any(-1))
    assert torch.equal(voxels, votes_of(scene, far, "none").read(scene, 0))
    assert reach_of(scene) == RENDERED_REACH_M
    scene.meta["facts"].pop("theme")  # as the scenes of a log, whose sensor ends nowhere
    assert reach_of(scene) is None
    assert not (votes_of(scene, far, "none").read(scene, 0) == UNKNOWN).any()


def test_rendered_scenes_and_logs_do_not_share_a_grid_beyond_the_rendered_points(root):
    far = Cylinder((20, 8, 2), (0.0, 50.0), (-2.8, 3.6))
    source = Recorded(str(root), PATTERNS)
    source._readers[0].meta["facts"].pop("theme")
    with pytest.raises(DataError, match=r"end at 26 m, those of logs do not.*data\.source\.splits"):
        source.labels(far, "none")
    assert source.labels(GRID, "none").beyond is None


@pytest.mark.parametrize(
    ("splits", "said"),
    [
        (None, "splits has None"),
        (7, "splits has 7"),
        ([[0.0], [1.0]], "splits has "),
        ({"train": [None], "val": [], "test": []}, r"splits\.train is \[None\]; give a list of names"),
        ({"train": [["a"]], "val": [], "test": []}, r"splits\.train is .*; give a list of names"),
        ({"train": "night-*", "val": [], "test": []}, r"splits\.train is 'night-\*'; give a list of names"),
        ({"train": 1, "val": None, "test": 0}, r"splits\.val is None"),
        ({"train": 10**400, "val": 0, "test": 0}, r"splits\.train is 1000"),
        ({"train": float("nan"), "val": 0, "test": 0}, r"splits\.train is nan"),
    ],
)
def test_a_damaged_file_of_splits_is_named(splits, said, root):
    (root / "splits.json").write_text(json.dumps(splits))
    with pytest.raises(DataError, match=rf"splits\.json: .*{said}"):
        _ = Recorded(str(root)).names
