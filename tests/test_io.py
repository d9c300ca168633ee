"""Writing of files: whole or not at all, never through what lies there already, and by no other way."""

import ast
import os
import re
import resource
import signal
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import DataError
from omniocc.io import atomic_file, atomic_write, check_regular, remove_leftovers
from omniocc.model.depth import DepthMap
from omniocc.predict.input.poses import write_poses
from omniocc.predict.output.range_files import PointCloud, write_depth, write_ply

SRC = Path(__file__).parents[1] / "src"
WRITERS = re.compile(
    r"(.*\.)?(write_text|write_bytes|imwrite|savefig|savez|savez_compressed|savetxt|tofile|touch|copyfile|copy2|copytree|"
    r"to_csv|NamedTemporaryFile|mkstemp|memmap|VideoWriter|save_file)"
    r"|(np|numpy|torch|torch\.export|pickle|json|yaml|csv)\.(save|dump|safe_dump|writer)|shutil\.(copy|move)"
)
"""Calls that write files, whatever their arguments."""
IN_MEMORY = {"buffer", "content", "stored", "out"}
"""Names of what such a call fills in memory."""
DIRECT = {
    ("omniocc/io.py", "os.open(temporary"): "the atomic writer itself",
    ("omniocc/io.py", "os.fdopen(descriptor"): "the atomic writer itself",
    (
        "omniocc/data/store/shard.py",
        "(self.work / shard_name(shard)).open(",
    ): "the folder gets its name when all files are whole",
    (
        "omniocc/data/store/reader.py",
        "(Path(folder) / name).write_bytes(",
    ): "a temporary folder, removed at once",
    (
        "omniocc/extras/recorders/bag_reader.py",
        "(Path(made) / place.name).write_text(",
    ): "a temporary folder, removed at once",
    ("omniocc/extras/recorders/bag_reader.py", "target.open('xb')"): "a temporary folder, removed at once",
    ("omniocc/extras/recorders/carla/client.py", "os.fdopen(os.dup(1)"): "the output of this process",
    ("omniocc/runs/fork_server.py", "os.fdopen(os.dup(1)"): "the output of this process",
    ("omniocc/runs/fork_server.py", "os.open(request['log']"): "the output of a process",
    ("omniocc/runs/fork_server.py", "log.open('wb')"): "the output of a process",
    ("omniocc/runs/script.py", "os.open(os.devnull"): "nothing is kept",
    ("hydra_plugins/process_launcher/job.py", "log.open('wb')"): "the output of a process",
    ("hydra_plugins/process_launcher/slurm.py", "self.log.open('a'"): "the output of a process",
    ("hydra_plugins/process_launcher/slurm.py", "log_of(self.log, task).open("): "the output of a process",
}
"""File and beginning of the calls that write past the atomic writer, and why."""


def writes(call: ast.Call) -> bool:
    """Return whether a call writes a file: by its name, or `open` by its mode or flags."""
    name, given = ast.unparse(call.func), [*call.args, *(word.value for word in call.keywords)]
    if name.rpartition(".")[2] in ("open", "fdopen", "ZipFile", "GzipFile"):
        modes = [part.value for part in given if isinstance(part, ast.Constant) and isinstance(part.value, str)]
        flags = {part.attr for part in ast.walk(call) if isinstance(part, ast.Attribute)}
        return any(re.fullmatch(r"[rwaxbt+]*[wax+][rwaxbt+]*", mode) for mode in modes) or bool(
            flags & {"O_WRONLY", "O_RDWR", "O_CREAT"}
        )
    targets = [] if name.endswith(("write_text", "write_bytes")) else given[:2]
    in_memory = any(isinstance(part, ast.Name) and part.id in IN_MEMORY for part in targets)
    return bool(WRITERS.fullmatch(name)) and not in_memory and not (name.startswith("yaml.") and len(call.args) == 1)


def test_every_result_is_written_by_the_atomic_writer():
    found = [
        (str(path.relative_to(SRC)), ast.unparse(node))
        for path in SRC.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and writes(node)
    ]
    excused = {
        place: [call for file, call in found if file == place[0] and call.startswith(place[1])] for place in DIRECT
    }
    direct = [(file, call) for file, call in found if not any(call in calls for calls in excused.values())]
    assert direct == [], "write by omniocc.io.atomic_write or atomic_file"
    assert [place for place, calls in excused.items() if not calls] == [], "these excuse nothing any more"


def test_temporary_files_are_new_and_have_names_that_nobody_knows_before(tmp_path):
    victim, path = tmp_path / "victim", tmp_path / "result.json"
    victim.write_text("precious")
    names = set()
    for _ in range(20):
        with atomic_file(path) as file:
            (temporary,) = tmp_path.glob(".result.json.*.tmp")
            names.add(temporary.name)
            file.write(b"new")
    assert len(names) == 20
    assert f".result.json.{os.getpid()}.tmp" not in names
    (tmp_path / f".result.json.{os.getpid()}.tmp").symlink_to(victim)
    atomic_write(path, "newer")
    assert (path.read_text(), victim.read_text()) == ("newer", "precious")


def test_a_name_that_exists_is_passed_over_and_not_written_to(tmp_path, monkeypatch):
    victim, path = tmp_path / "victim", tmp_path / "result"
    victim.write_text("precious")
    (tmp_path / ".result.taken.tmp").symlink_to(victim)
    tokens = iter(["taken", "free"])
    monkeypatch.setattr("omniocc.io.secrets.token_hex", lambda _: next(tokens))
    atomic_write(path, b"new")
    assert (path.read_text(), victim.read_text()) == ("new", "precious")
    assert (tmp_path / ".result.taken.tmp").is_symlink()


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_file_has_the_mode_of_a_plain_open(mask, tmp_path):
    before = os.umask(mask)
    try:
        atomic_write(tmp_path / "ours", b"")
        (tmp_path / "plain").touch()
    finally:
        os.umask(before)
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_the_longest_name_can_be_written_and_leftovers_of_any_name_are_removed(tmp_path):
    for name in ("a" * 240, "train-[0]*.json"):
        path = tmp_path / name
        atomic_write(path, b"1")
        leftover = path.with_name(f".{name}.1a2b3c4d.tmp")
        leftover.touch()
        remove_leftovers(path)
        assert path.exists()
        assert not leftover.exists()


def test_what_is_no_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    check_regular(tmp_path / "link")
    for path, kind in ((tmp_path / "pipe", "pipe"), (tmp_path, "folder"), (Path("/dev/zero"), "device")):
        with pytest.raises(DataError, match=rf"^{path} cannot be read: it is a {kind}, not a file$"):
            check_regular(path)
    with pytest.raises(FileNotFoundError):
        check_regular(tmp_path / "dangling")
    with pytest.raises(DataError, match=r"loop cannot be read: .*symbolic links"):
        check_regular(tmp_path / "loop")


def rig_with_masks(path: Path) -> None:
    rig = Rig.load("surround_view")
    noise = np.random.default_rng(0)
    masks = [torch.from_numpy(noise.random((camera.height, camera.width)) > 0.5) for camera in rig.cameras]
    replace(rig, masks=tuple(masks)).save(path)


def depth_files(path: Path) -> None:
    panorama = Equirectangular(64, 32, 40.0, -50.0)
    range_m = torch.rand(1, 32, 64, generator=torch.manual_seed(0)) * 50
    depth = DepthMap(range_m, range_m, torch.ones(1, 32, 64, dtype=torch.bool), torch.ones(1, 32, 64))
    cloud = PointCloud(torch.rand(32, 64, 3).double(), torch.zeros(32, 64, 3, dtype=torch.uint8))
    write_depth(path.parent, depth, panorama, cloud, np.zeros((8, 8, 3), np.uint8))


WRITERS_OF_RESULTS: dict[str, Callable[[Path], object]] = {
    "front.png": rig_with_masks,
    "range.png": depth_files,
    "poses.csv": lambda path: write_poses(path, ["0"] * 100, torch.eye(4, dtype=torch.float64).expand(100, 4, 4)),
    "points.ply": lambda path: write_ply(
        path, PointCloud(torch.rand(32, 64, 3).double(), torch.zeros(32, 64, 3, dtype=torch.uint8))
    ),
}


@pytest.mark.parametrize("name", WRITERS_OF_RESULTS)
def test_a_full_disk_cuts_no_result_and_is_named(name, tmp_path):
    path = tmp_path / name
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, limits[1]))
    try:
        with pytest.raises(DataError, match=rf"^cannot write {tmp_path}/[\w.]+: files may not grow that large"):
            WRITERS_OF_RESULTS[name](path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_inodes_is_told_from_a_full_one(tmp_path):
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "nr_inodes=2", "tmpfs", tmp_path], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"only root may mount a small disk: {mounted.stderr.decode().strip()}")
    try:
        atomic_write(tmp_path / "first", b"")
        with pytest.raises(DataError, match=r"^cannot write .*second: the disk takes no more files: remove some, then"):
            atomic_write(tmp_path / "second", b"")
    finally:
        subprocess.run(["umount", tmp_path], check=True)
