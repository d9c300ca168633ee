"""Damage what parses, in every place of small sound files, and read it in this process; part of `make test-hostile`.

A reader must succeed, or raise its one error, which names the file. HOSTILE_SEED=1 draws other damage, HOSTILE_ALL=1
takes all of it.
"""

import contextlib
import io
import json
import os
import random
import re
import resource
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import forge_datasets
import forge_rigs
import numpy as np
import pytest
import torch
import yaml
import zstandard
from damage import ARRAYS, BYTES, damaged_trees, dumped
from forge_checkpoints import write_weights
from forge_scenes import SHARD, of_blob, seal, write_anew
from log_files import write_pcd, write_ply
from made_scenes import RIG, make_frame
from mutate import linked_copy

from omniocc.camera import Rig
from omniocc.check import read_back
from omniocc.data import OccupancyData, SceneReader, SourceSpec
from omniocc.data.formats.clouds import read_cloud
from omniocc.data.source.recorded import SPLITS_FILE, spec_of
from omniocc.data.store.codec import FACTS
from omniocc.data.store.folder import SceneFolder
from omniocc.data.store.meta import append_frame, finish_scene
from omniocc.data.store.shard import INDEX, META, SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.frame import Box
from omniocc.io import parse_yaml
from omniocc.parts import Parts
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.weights import digest_of

pytestmark = [pytest.mark.hostile, pytest.mark.filterwarnings("ignore")]
SEED = int(os.environ.get("HOSTILE_SEED", "0"))
SCENE = "test-000-here"
FRAMES = 2
BOX = Box(1, 7, (5.0, 0.0, 0.0), (4.0, 2.0, 1.5), 0.1, (3.0, 0.0))
MEMBERS = ("rgb0.jpg", "semantic0.zst", "range0.zst", "erp_range.zst", "points.zst", "lidar.zst")
OUTSIDE = (
    "have a ray",
    "model's grid is occupied",
    "since the frame before",
    "lies in an occupied cell",
    "unpack the sequence",
    "are left out",
    "all splits are empty",
)
"""Texts of problems that name scene and camera or frame: the file can be read, and what it says makes no sense."""
WORDS = ("nan", "inf", "1e400", "left", "", "0", "-1", "1e30", "null", "1" * 5000, "1_0", "[1]")
DATASET_DAMAGES = 8
"""Damages of each file of a dataset that one seed draws."""
SPARE_BYTES = 2**31
Damages = Iterator[tuple[str, Any]]


class Faulty(Exception):  # noqa: N818 - no error of the project, so that no reader turns it into one
    """What a reader did that it must not do."""


@pytest.fixture
def enough_memory() -> Iterator[None]:
    """Let this process take two GiB more than it has."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text("utf-8").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + SPARE_BYTES, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


def drawn(damages: Damages, most: int) -> Sequence[tuple[str, Any]]:
    """Return some damages, others for another seed."""
    found = list(damages)
    if os.environ.get("HOSTILE_ALL") == "1":
        return found
    return random.Random(SEED).sample(found, min(most, len(found)))


def fault_of(read: Callable[[], object], names: Iterable[str]) -> str | None:
    """Return what a reader did that it must not do: another error than its own, or one that names no file."""
    try:
        read()
    except Faulty as error:
        return str(error)
    except (UserError, DataError) as error:
        return None if any(name in str(error) for name in names) else f"names no file: {error}"
    except Exception as error:  # which is what this looks for
        return f"{type(error).__name__}: {str(error)[:200]}"
    return None


def faults(
    damages: Sequence[tuple[str, Any]], sound: Path, box: Path, read: Callable[[Path], object], names: Sequence[str]
) -> str:
    """Return what a reader did wrong with copies of a sound folder, each of them damaged, a line each."""
    found = [] if (fault := _fault(lambda box: None, sound, box, read, ())) is None else [f"sound: {fault}"]
    for name, change in damages:
        if (fault := _fault(change, sound, box, read, names)) is not None:
            found.append(f"{name}: {fault}")
    return "\n".join(found)


def _fault(change: Callable[[Path], object], sound: Path, box: Path, read: Any, names: Sequence[str]) -> str | None:
    shutil.rmtree(box, ignore_errors=True)
    linked_copy(sound, box)
    change(box)
    return fault_of(partial(read, box), names)


def raise_problems(data: OccupancyData) -> None:
    """Raise DataError for what `check.py` prints about a dataset."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
        if read_back(data, 0, 0, None):
            raise DataError(printed.getvalue())


def of_scene(spec: SourceSpec, folder: Path) -> None:
    """Write a sound scene with a box, and the file of splits beside it."""
    writer = SceneWriter(folder / SCENE)
    for index in range(FRAMES):
        append_frame(writer, replace(make_frame(index), boxes=(BOX,)))
    finish_scene(writer, RIG, spec, (45.0, -45.0), {"split": "test"})
    writer.close()
    (folder / SPLITS_FILE).write_text(json.dumps({"train": [], "val": [], "test": [SCENE]}))


def sealed(change: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: change(folder / SCENE)


def meta_damages(folder: Path) -> Damages:
    meta = json.loads((folder / SCENE / META).read_text())
    for name, tree in damaged_trees({key: value for key, value in meta.items() if key != "digest"}):
        content = dumped(tree | {"digest": digest(tree)} if isinstance(tree, dict) else tree)
        yield name, lambda box, content=content: write_anew(box / SCENE / META, content)


def index_damages(folder: Path) -> Damages:
    for name, tree in damaged_trees(json.loads((folder / SCENE / INDEX).read_text())):

        def change(box: Path, content: bytes = dumped(tree)) -> None:
            write_anew(box / SCENE / INDEX, content)
            seal(box / SCENE)

        yield name, change


def frame_damages(folder: Path) -> Damages:
    facts = json.loads(SceneFolder(folder / SCENE).read(0, [FACTS])[FACTS])
    for name, tree in damaged_trees(facts):
        content = dumped(tree)
        yield name, sealed(of_blob(FACTS, lambda blob, content=content: content))


def member_damages(folder: Path) -> Damages:
    for member in MEMBERS:
        for name, change in BYTES.items():
            yield f"{member}-{name}", sealed(of_blob(member, change))
            if member.endswith(".zst"):
                yield (
                    f"{member}-inner-{name}",
                    sealed(of_blob(member, lambda blob, change=change: inside(blob, change))),
                )


def inside(blob: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Return a compressed blob with other content."""
    return zstandard.ZstdCompressor().compress(change(zstandard.ZstdDecompressor().decompress(blob)))


def scene_rig_damages(folder: Path) -> Damages:
    for name, tree in damaged_trees(yaml.safe_load((folder / SCENE / "rig.yaml").read_text())):

        def change(box: Path, content: bytes = yaml.safe_dump(tree).encode()) -> None:
            write_anew(box / SCENE / "rig.yaml", content)
            seal(box / SCENE)

        yield name, change


def splits_damages(folder: Path) -> Damages:
    for splits in ({"train": [SCENE], "val": [], "test": []}, {"train": 0.5, "val": 0, "test": 0.5}):
        for name, tree in damaged_trees(splits):
            content = dumped(tree)
            yield name, lambda box, content=content: write_anew(box / SPLITS_FILE, content)


SCENE_DAMAGES: dict[str, tuple[Callable[[Path], Damages], tuple[str, ...], int]] = {
    "meta": (meta_damages, (META, INDEX, SHARD, "rig."), 150),
    "index": (index_damages, (INDEX, SHARD), 100),
    "frame": (frame_damages, (SHARD,), 60),
    "members": (member_damages, (SHARD,), 60),
    "rig": (scene_rig_damages, ("rig.yaml", SHARD), 40),
    "splits": (splits_damages, (SPLITS_FILE,), 150),
}
"""Damages of a scene, texts of which an error must hold one, and how many damages one seed draws."""


@pytest.mark.parametrize("kind", SCENE_DAMAGES)
def test_scenes(kind, spec, smoke, tmp_path, enough_memory):
    damages, names, most = SCENE_DAMAGES[kind]
    names = (*names, *OUTSIDE)
    sound, box = tmp_path / "sound", tmp_path / "box"
    of_scene(spec, sound)
    options = (f"data.source.root={box}", "data.source.splits=null", f"data.source.cache={tmp_path / 'cache'}")
    cfg = smoke("data=recorded", *options, "data.source.workers=0")

    def read(box: Path) -> None:
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)
        scene = SceneReader(box / SCENE)
        parts = (scene.images, scene.pixel_labels, scene.camera_range_m, scene.erp_range_m, scene.lidar, scene.points)
        facts = (spec_of, len, attrgetter("rig"), attrgetter("time_s"), attrgetter("world_from_ego"))
        for part in (*(partial(fact, scene) for fact in facts), *(partial(part, 0) for part in parts)):
            if (fault := fault_of(part, names)) is not None:
                raise Faulty(fault)
        raise_problems(Parts(cfg).data())

    assert faults(drawn(damages(sound), most), sound, box, read, names) == ""


def numbers_of(text: str) -> Damages:
    """Yield texts with another word in place of one, without a line, and with a line twice."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        yield f"line {number} twice", "\n".join([*lines[:number], line, *lines[number:]])
        yield f"line {number} removed", "\n".join([*lines[:number], *lines[number + 1 :]])
        for word in list(re.finditer(r"[^\s,]+", line))[:8]:
            for value in WORDS:
                changed = line[: word.start()] + value + line[word.end() :]
                yield f"line {number}: {value[:9]!r}", "\n".join([*lines[:number], changed, *lines[number + 1 :]])


def array_damages(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield other arrays, as far as an array of this type and shape can be changed so."""
    for name, change in ARRAYS.items():
        with contextlib.suppress(ValueError, TypeError, OverflowError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield name, change(array)


def npz_of(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npy_of(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def contents(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield damaged contents of a file, by the suffix of its name."""
    content = path.read_bytes()
    yield from ((name, change(content)) for name, change in BYTES.items())
    if path.suffix in (".txt", ".csv", ".yaml"):
        yield from ((name, text.encode()) for name, text in numbers_of(content.decode()))
    elif path.suffix == ".json":
        yield from ((name, dumped(tree)) for name, tree in damaged_trees(json.loads(content)))
    elif path.suffix == ".npy":
        yield from ((name, npy_of(array)) for name, array in array_damages(np.load(path)))
    elif path.suffix == ".npz":
        with np.load(path) as file:
            arrays = dict(file)
        for key, old in arrays.items():
            yield f"{key} removed", npz_of(**{name: array for name, array in arrays.items() if name != key})
            yield from ((f"{key} {name}", npz_of(**arrays | {key: array})) for name, array in array_damages(old))
    elif path.suffix in (".pcd", ".ply"):
        head = content[: content.index(b"\n", content.index({".pcd": b"DATA", ".ply": b"end_header"}[path.suffix]))]
        for name, text in numbers_of(head.decode()):
            yield name, text.encode() + content[len(head) :]


def file_damages(folder: Path, files: Sequence[str]) -> Damages:
    for file in files:
        for name, content in contents(folder / file):
            yield f"{file} {name}", lambda box, file=file, content=content: write_anew(box / file, content)


def test_clouds(tmp_path, enough_memory):
    sound = tmp_path / "sound"
    sound.mkdir()
    points, labels = np.random.default_rng(0).uniform(-20, 20, (50, 3)).astype(np.float32), np.arange(50) % 9
    for encoding in ("ascii", "binary", "binary_compressed"):
        write_pcd(sound / f"{encoding}.pcd", points, labels, encoding)
    for encoding in ("ascii", "binary_little_endian"):
        write_ply(sound / f"{encoding}.ply", points, labels, encoding)
    np.savez(sound / "a.npz", points=points, labels=labels)
    np.c_[points, labels].astype("<f4").tofile(sound / "a.bin")
    labels.astype("<u4").tofile(sound / "a.label")
    for path in sound.iterdir():
        opened = path.with_suffix(".bin") if path.suffix == ".label" else path
        read = lambda box, name=opened.name: read_cloud(box / name)  # noqa: E731
        assert faults(drawn(file_damages(sound, [path.name]), 150), sound, tmp_path / "box", read, (opened.stem,)) == ""


@pytest.mark.parametrize("kind", forge_rigs.sound())
def test_rigs(kind, tmp_path, enough_memory):
    (sound := tmp_path / "sound").mkdir()
    path = forge_rigs.write(sound, kind)

    def damages() -> Damages:
        yield from file_damages(sound, [path.name])
        if kind != "ocamcalib":
            for name, tree in damaged_trees(parse_yaml(path.read_text())):
                content = yaml.safe_dump(tree).encode()
                yield name, lambda box, content=content: write_anew(box / path.name, content)

    def read(box: Path) -> None:
        try:
            Rig.load(box / path.name)
        except ValueError as error:  # which scripts turn into one line, see `load_rig`
            raise UserError(str(error)) from error

    assert faults(drawn(damages(), 250), sound, tmp_path / "box", read, (path.name,)) == ""


@pytest.mark.parametrize("source", forge_datasets.SOURCES)
def test_datasets(source, smoke, tmp_path, enough_memory):
    sound, box = tmp_path / "sound", tmp_path / "box"
    writer, options = forge_datasets.SOURCES[source]
    writer(sound)
    options = (f"data.source.root={box}", *(f"data.source.{option}" for option in options))
    cfg = smoke(f"data={source}", *options, f"data.source.cache={tmp_path / 'cache'}")

    def read(box: Path) -> None:
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)
        raise_problems(Parts(cfg).data())

    for file in forge_datasets.FILES[source]:
        names = (Path(file).name, *(path.name for path in (sound / file).parent.glob("*.json")), *OUTSIDE)
        assert faults(drawn(file_damages(sound, [file]), DATASET_DAMAGES), sound, box, read, names) == ""


def test_weights_and_checkpoints(tmp_path, enough_memory):
    (sound := tmp_path / "sound").mkdir()
    weights = {"model.a": torch.zeros(3)}
    about = {"stage": "occupancy", "config": {"model": {"a": 1}}, "facts": {}, "sha256": digest_of(weights)}

    def damages() -> Damages:
        for name, tree in damaged_trees(about):
            yield name, lambda box, tree=tree: write_weights(box / "a.safetensors", json.dumps(tree), weights)
        whole = {"stage": "occupancy", "config": {"model": {"a": 1}}, "state_dict": {"a": 1}, "global_step": 3}
        for name, tree in damaged_trees(whole):
            yield name, lambda box, tree=tree: torch.save(tree, box / "a.ckpt")

    def read(box: Path) -> None:
        for path in box.iterdir():
            load_checkpoint(path)

    assert faults(drawn(damages(), 300), sound, tmp_path / "box", read, ("a.safetensors", "a.ckpt")) == ""
