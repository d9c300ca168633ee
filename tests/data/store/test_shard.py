import subprocess
import tarfile
from pathlib import Path

import numpy as np
import pytest

from omniocc import io
from omniocc.data.store import shard
from omniocc.data.store.files import list_folders
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import INDEX, META, SceneWriter
from omniocc.errors import DataError

LIMIT = 40_000


def blobs(frame: int) -> dict[str, bytes]:
    return {"a.bin": bytes([frame]) * 7000, "b.bin": bytes(range(256)) * (10 + frame)}


def write(folder, frames=range(6), finish=True, limit=LIMIT):
    writer = SceneWriter(folder, limit)
    for frame in frames:
        writer.append(blobs(frame), {"time_s": frame / 10, "world_from_ego": np.eye(4).tolist()})
    if finish:
        writer.finish({"seed": 5})
    writer.close()
    return writer


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_any_member_can_be_read_in_any_order(tmp_path):
    write(tmp_path / "scene")
    reader = SceneReader(tmp_path / "scene")
    assert len(reader) == 6
    for frame in (4, 0, 5):
        assert reader.read(frame, ["b.bin", "a.bin"]) == blobs(frame)
    assert reader.time_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert reader.meta["facts"] == {"seed": 5}


def test_shards_are_valid_tar_files_below_the_limit(tmp_path):
    write(tmp_path / "scene")
    shards = sorted((tmp_path / "scene").glob("*.tar"))
    assert [shard.name for shard in shards] == ["frames-000.tar", "frames-001.tar"]
    assert all(shard.stat().st_size <= LIMIT for shard in shards)
    names = [name for shard in shards for name in subprocess.check_output(["tar", "tf", shard], text=True).split()]
    assert names == [f"{frame:06d}.{member}" for frame in range(6) for member in ("a.bin", "b.bin")]
    with tarfile.open(shards[0]) as tar:
        info = tar.getmember("000001.b.bin")
        assert (info.mtime, info.uid, info.gid, info.uname) == (0, 0, 0, "")
        assert tar.extractfile(info).read() == blobs(1)["b.bin"]


@pytest.mark.parametrize("whole", range(7))
def test_interrupted_after_any_frame_is_made_again_with_the_same_bytes(tmp_path, whole):
    write(tmp_path / "reference")
    target = tmp_path / "other" / "reference"
    writer = write(target, range(whole), finish=False)
    with (writer.work / f"frames-{(whole > 3) * 1:03d}.tar").open("ab") as file:  # killed within the next frame
        file.write(b"half a frame" * 100)
    assert list_folders(target.parent, META) == []
    assert not SceneWriter(target, LIMIT).finished
    write(target)
    assert content(target) == content(tmp_path / "reference")
    assert not writer.work.exists()


@pytest.mark.parametrize("moment", ["index.json", "meta.json", "rename"])
def test_killed_while_sealing(tmp_path, moment, monkeypatch):
    write(tmp_path / "reference")
    target = tmp_path / "other" / "reference"

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if moment == "rename":
            patch.setattr(Path, "rename", killed)
        else:
            patch.setattr(shard, "atomic_write", lambda p, c: killed() if p.name == moment else io.atomic_write(p, c))
        with pytest.raises(KeyboardInterrupt):
            write(target)
    assert list_folders(target.parent, INDEX) == list_folders(target.parent, META) == []
    assert not SceneWriter(target, LIMIT).finished
    write(target)
    assert content(target) == content(tmp_path / "reference")


def test_a_finished_scene_is_left_alone(tmp_path):
    write(tmp_path / "scene")
    before = content(tmp_path / "scene")
    assert SceneWriter(tmp_path / "scene", LIMIT).finished
    assert content(tmp_path / "scene") == before
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def damaged_read(folder, frame, member="b.bin"):
    with pytest.raises(DataError) as error:
        SceneReader(folder).read(frame, [member])
    return str(error.value)


def test_a_flipped_byte_is_named(tmp_path):
    write(tmp_path / "scene")
    shard = tmp_path / "scene" / "frames-001.tar"
    offset = SceneReader(tmp_path / "scene").index.offset[4, 1]
    raw = bytearray(shard.read_bytes())
    raw[offset + 17] ^= 4
    shard.write_bytes(raw)
    message = damaged_read(tmp_path / "scene", 4)
    assert str(shard) in message
    assert "scene 'scene', frame 4, member 'b.bin': checksum differs" in message
    assert f"Make the scene again (delete the folder {tmp_path / 'scene'}, then" in message
    assert SceneReader(tmp_path / "scene").read(4, ["a.bin"]) == {"a.bin": blobs(4)["a.bin"]}


def test_a_truncated_shard_is_named(tmp_path):
    write(tmp_path / "scene")
    shard = tmp_path / "scene" / "frames-000.tar"
    with shard.open("r+b") as file:
        file.truncate(3000)
    assert "frame 0, member 'a.bin': the file is cut short" in damaged_read(tmp_path / "scene", 0, "a.bin")


def test_a_missing_shard_and_a_missing_member_are_named(tmp_path):
    write(tmp_path / "scene")
    (tmp_path / "scene" / "frames-000.tar").unlink()
    assert "frame 2, member 'b.bin': the file is missing" in damaged_read(tmp_path / "scene", 2)
    assert "no member 'c.bin' (it has: a.bin, b.bin)" in damaged_read(tmp_path / "scene", 5, "c.bin")


@pytest.mark.parametrize("name", ["meta.json", "index.json"])
@pytest.mark.parametrize("harm", ["flip", "cut", "remove"])
def test_damaged_descriptions_are_named(tmp_path, name, harm):
    write(tmp_path / "scene")
    path = tmp_path / "scene" / name
    raw = path.read_bytes()
    if harm == "remove":
        path.unlink()
    else:
        path.write_bytes(raw[:50] if harm == "cut" else raw.replace(b"5", b"6", 1))
    assert str(path) in damaged_read(tmp_path / "scene", 0)


def test_a_full_disk_is_one_clear_error(tmp_path, monkeypatch):
    write(tmp_path / "reference")
    target = tmp_path / "other" / "reference"

    def full(file, chunk):
        file.write(chunk[: len(chunk) // 2])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(shard, "_write_all", full)
        with pytest.raises(DataError, match=r"write .*reference.*full"):
            write(target)
    write(target)
    assert content(target) == content(tmp_path / "reference")
