"""Small files that claim to be huge, and what is no file: one line with file, value and limit, within little memory."""

import json
import os

import numpy as np
import pytest
import torch
import zstandard
from sealed_scenes import RIG, changed_file, changed_meta, scene_of

from omniocc.camera import Rig
from omniocc.data import SceneReader
from omniocc.data.labels.counts import kept_counts
from omniocc.data.labels.voxels import MEMBER, VoxelCache
from omniocc.data.store.check import check_scene
from omniocc.data.store.files import LIMIT_BYTES, list_folders, read_json
from omniocc.data.store.folder import SceneFolder
from omniocc.data.store.reader import RIG_LIMIT_BYTES
from omniocc.data.store.shard import INDEX, META, SceneWriter
from omniocc.errors import DataError, repr_of
from omniocc.geometry import Cuboid

pytestmark = pytest.mark.usefixtures("little_memory")
PIXELS = 64 * 36


def zeros(count: int) -> bytes:
    """Return a zstd frame of this many zeros, made piece by piece."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=count)
    piece = bytes(2**20)
    parts = [compressor.compress(piece[: min(2**20, count - begin)]) for begin in range(0, count, 2**20)]
    return b"".join([*parts, compressor.flush()])


def image_of_zeros(height: int, width: int, itemsize: int) -> bytes:
    """Return a raster of zeros as a zstd frame."""
    size = height * width * itemsize
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=4 + size)
    parts = [compressor.compress(np.array([height, width], "<u2").tobytes())]
    parts += [compressor.compress(bytes(min(2**20, size - begin))) for begin in range(0, size, 2**20)]
    return b"".join([*parts, compressor.flush()])


@pytest.fixture(scope="module")
def bomb() -> bytes:
    """The largest image that a header can state, 8.6 GB."""
    return image_of_zeros(65535, 65535, 2)


READ = {
    "semantic{}.zst": (SceneReader.pixel_labels, 2 * PIXELS + 4),
    "range{}.zst": (SceneReader.camera_range_m, 2 * PIXELS + 4),
    "erp_range.zst": (SceneReader.erp_range_m, 2 * 2**26 + 4),
    "points.zst": (SceneReader.points, 7 * 2**25),
}


@pytest.mark.parametrize("member", READ)
def test_a_member_that_unpacks_to_more_than_the_rig_allows(member, tmp_path, bomb):
    read, limit = READ[member]
    assert len(bomb) < 2**20
    names = dict.fromkeys(member.format(k) for k in range(len(RIG.cameras)))
    scene = scene_of(tmp_path / "scene", dict.fromkeys(names, bomb))
    first = next(iter(names))
    with pytest.raises(DataError) as error:
        read(scene, 0)
    assert f"frames-000.tar: scene 'scene', frame 0, member '{first}': it cannot be decoded" in str(error.value)
    assert f"it unpacks to {2 * 65535**2 + 4:,} bytes, at most {limit:,} are expected" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_lidar_has_the_rays_that_the_format_fixes(tmp_path):
    rays = len(SceneReader.lidar.__globals__["_lidar_directions"]())
    scene = scene_of(tmp_path / "scene", {"lidar.zst": zeros(3 * rays + 3)})
    limit = rf"'lidar\.zst': it cannot be decoded .*unpacks to {3 * rays + 3:,} bytes, at most {3 * rays:,}"
    with pytest.raises(DataError, match=limit):
        scene.lidar(0)


def test_an_image_just_as_large_as_the_camera_is_read(tmp_path):
    names = [f"range{k}.zst" for k in range(len(RIG.cameras))]
    scene = scene_of(tmp_path / "scene", dict.fromkeys(names, image_of_zeros(36, 64, 2)))
    assert [image.shape for image in scene.camera_range_m(0) or ()] == [(36, 64)] * len(names)
    larger = scene_of(tmp_path / "larger", dict.fromkeys(names, image_of_zeros(36, 65, 2)))
    with pytest.raises(DataError, match=rf"unpacks to {2 * 36 * 65 + 4:,} bytes, at most {2 * PIXELS + 4:,}"):
        larger.camera_range_m(0)


@pytest.mark.parametrize("frames", [-1, True, "1", 10**400])
def test_a_number_of_frames_that_no_index_lists(frames, tmp_path):
    scene_of(tmp_path / "scene", {})
    changed_meta(tmp_path / "scene", frames=frames)
    index_bytes = (tmp_path / "scene" / INDEX).stat().st_size
    with pytest.raises(DataError) as error:
        len(SceneReader(tmp_path / "scene"))
    said = f"'frames' is {repr_of(frames)}, but its index.json of {index_bytes:,} bytes can list at most"
    assert f"{tmp_path}/scene/meta.json" in str(error.value)
    assert f"{said} {index_bytes // 50}. " in str(error.value)


def test_a_number_of_frames_that_the_index_does_not_list(tmp_path):
    scene_of(tmp_path / "scene", {})
    changed_meta(tmp_path / "scene", frames=3)
    with pytest.raises(DataError, match=r"index\.json: .*1 frames instead of 3"):
        _ = SceneReader(tmp_path / "scene").index


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("size", [[2**40, 5]], "OverflowError|out of bounds"),
        ("size", [[2**31 - 1, 5]], r"frame 0 has members outside of frames-000\.tar, of [\d,]+ bytes"),
        ("offset", [[-5, 512]], "frame 0 has members outside of frames-000"),
        ("shard", [7], r"frame 0 has members outside of frames-007\.tar, of 0 bytes"),
    ],
)
def test_members_outside_of_their_shard(key, value, said, tmp_path):
    scene_of(tmp_path / "scene", {"a.bin": b"12345"})
    index = json.loads((tmp_path / "scene" / INDEX).read_text())
    index["frames"][0][key] = value[0]
    changed_file(tmp_path / "scene", INDEX, json.dumps(index).encode())
    with pytest.raises(DataError, match=rf"index\.json: .*it is no index of this scene \(.*({said})"):
        SceneReader(tmp_path / "scene").read(0, ["a.bin"])


@pytest.mark.parametrize(
    "files", [None, [], {"../rig.yaml": {"size": 1, "sha256": ""}}, {"a": 1}, {"a": {"size": "1", "sha256": ""}}]
)
def test_facts_of_files_that_make_no_sense(files, tmp_path):
    scene_of(tmp_path / "scene", {})
    changed_meta(tmp_path / "scene", files=files)
    said = "'files' has an impossible entry|it has no 'files'|the name of a file is '../rig.yaml'"
    with pytest.raises(DataError, match=rf"meta\.json: .*({said})"):
        len(SceneReader(tmp_path / "scene"))


def test_meta_files_that_are_long_or_deep(tmp_path):
    scene_of(tmp_path / "scene", {})
    with (tmp_path / "scene" / META).open("r+b") as file:
        file.truncate(2**40)  # a hole that takes no space
    with pytest.raises(DataError, match=rf"meta\.json: the file has more than {LIMIT_BYTES:,} bytes"):
        len(SceneReader(tmp_path / "scene"))
    with pytest.raises(DataError, match=rf"meta\.json: .*more than {LIMIT_BYTES:,} bytes"):
        read_json(tmp_path / "scene", META, "write another")
    (tmp_path / "scene" / META).write_text("[" * 10**6)
    with pytest.raises(DataError, match=r"meta\.json: scene 'scene': it is not valid JSON"):
        len(SceneReader(tmp_path / "scene"))


def test_rigs_that_are_long_or_of_many_cameras(tmp_path):
    scene_of(tmp_path / "scene", {})
    changed_file(tmp_path / "scene", "rig.yaml", b"cameras:\n" + b" " * RIG_LIMIT_BYTES)
    with pytest.raises(DataError, match=rf"rig\.yaml: the file has more than {RIG_LIMIT_BYTES:,} bytes"):
        _ = SceneReader(tmp_path / "scene").rig
    entry = "{model: pinhole}"
    (tmp_path / "rig.yaml").write_text("cameras:\n" + "".join(f"  c{k}: {entry}\n" for k in range(101)))
    with pytest.raises(ValueError, match=r"rig\.yaml: 'cameras' has 101 entries; at most 100 are read"):
        Rig.load(tmp_path / "rig.yaml")


NO_FILES = {
    "pipe": lambda path: os.mkfifo(path),
    "folder": lambda path: path.mkdir(),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path.name),
    "dangling": lambda path: path.symlink_to("nowhere"),
}


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((kind, META) for kind in NO_FILES),
        ("pipe", INDEX),
        ("loop", "rig.yaml"),
        *((kind, "frames-000.tar") for kind in NO_FILES),
    ],
)
def test_what_is_no_file_is_not_opened(kind, name, tmp_path):
    scene = scene_of(tmp_path / "scene", {})
    (tmp_path / "scene" / name).unlink()
    NO_FILES[kind](tmp_path / "scene" / name)
    words = {"loop": "symbolic links", "dangling": "the file is missing"}
    with pytest.raises(DataError) as error:  # noqa: PT012 - one of them reads the file
        scene.read(0, ["frame.json"])
        assert scene.rig is None
    assert f"{tmp_path}/scene/{name}" in str(error.value)
    assert words.get(kind, f"it is a {kind}, not a file") in str(error.value)
    assert any(f"{tmp_path}/scene/{name}" in line for line in check_scene(SceneReader(tmp_path / "scene"), 1, 0.5))


def test_a_listing_does_not_open_a_pipe(tmp_path):
    (tmp_path / "scene").mkdir()
    os.mkfifo(tmp_path / "scene" / META)
    with pytest.raises(DataError, match=r"meta\.json cannot be read: it is a pipe, not a file"):
        list_folders(tmp_path, META)


def test_kept_voxels_and_counts_are_made_anew(tmp_path, bomb):
    grid = Cuboid(shape=(2, 2, 2), x_m=(-1.0, 1.0), y_m=(-1.0, 1.0), height_m=(-1.0, 1.0))
    cache = VoxelCache(tmp_path, grid)
    writer = SceneWriter(cache.folder / "scene")
    writer.append({MEMBER: bomb}, {})
    writer.finish({})
    scene = SceneFolder(cache.folder / "scene")
    cache._vote = lambda *_: "voted"  # type: ignore[method-assign,assignment,return-value]
    with pytest.warns(UserWarning, match=r"voted anew: .*at most 8 are expected"):
        assert cache.read(scene, 0) == "voted"  # type: ignore[arg-type]
    (tmp_path / "counts.zst").write_bytes(bomb)
    with pytest.warns(UserWarning, match="at most 64 are expected"):
        counts = kept_counts(tmp_path / "counts.zst", (1, 2, 2, 2), lambda: torch.ones(1, 2, 2, 2).long())
    assert counts.sum() == 8
