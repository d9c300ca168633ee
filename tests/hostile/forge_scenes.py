"""Forge recorded scenes: files and shards with other bytes, and sealed ones, whose every checksum is right."""

import copy
import hashlib
import json
import random
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zstandard
from made_scenes import SCENES
from mutate import BROKEN, DAMAGED, linked_copy
from sandbox import Box, Case, Opening, some

from omniocc.data.store.codec import FACTS, LIDAR, PANORAMA, POINTS, pack
from omniocc.data.store.folder import SceneFolder
from omniocc.data.store.shard import INDEX, META, SceneWriter, digest

KIND = "scenes and shards"
SCENE = SCENES[0]
COMMANDS = 2
"""Commands beside the check that open a scene, drawn at random."""
Tree = dict[str, Any]
SHARD = "frames-000.tar"


def openings(box: Box, names: tuple[str, ...], expect: str, seed: float) -> list[Opening]:
    """Return the check of all frames, and some of the commands that read scenes."""
    root, base = box.given / "scenes", box.base
    data = f"data.source.root={root}"
    splits = "data.source.splits={train:[test-000-*],val:[test-001-*],test:[test-002-*]}"
    own = ("data=recorded", data, splits, f"data.source.cache={box.out / 'cache'}", "preset=smoke")
    checkpoint, out = str(base / "run" / "best.ckpt"), f"output={box.out / 'result'}"
    others = [
        ("view.py", f"recorded={root / SCENE}", "page=true", "limit=null", f"{out}.html"),
        ("view.py", f"recorded={root / SCENE}", "limit=null", f"save={box.out / 'view.rrd'}"),
        ("predict.py", "occupancy", f"checkpoint={checkpoint}", f"recorded={root / SCENE}", out, "overview=false"),
        ("mask.py", f"scenes={root}", f"{out}.yaml"),
        ("report.py", "--datasets", str(root)),
        ("train.py", *own, "plan=true", f"paths.runs={box.out / 'runs'}", f"paths.data={box.out / 'data'}"),
        ("evaluate.py", checkpoint, data, own[3], "--output", str(box.out / "result")),
    ]
    # a folder whose meta.json is no file is no scene, which several commands pass over
    names = (*names, SCENE, "no recorded scenes", str(root))
    found = [Opening(("check.py", *own, "--workers", "0"), expect, names)]
    return found + some([Opening(command, "either", names) for command in others], COMMANDS, random.Random(seed))


def copied(box: Box) -> Path:
    """Copy the scenes into a box, and return the folder of the one that is to be changed."""
    return linked_copy(box.base / "scenes", box.given / "scenes") / SCENE


def write_anew(path: Path, content: bytes) -> None:
    """Replace a file, which may be linked elsewhere."""
    path.unlink()
    path.write_bytes(content)


def seal(folder: Path, change: Callable[[Tree], Any] = lambda meta: None) -> None:
    """Change the facts of a scene, and give all its files the checksums that they have."""
    meta = json.loads((folder / META).read_text())
    meta.pop("digest")
    for name in meta["files"]:
        content = (folder / name).read_bytes()
        meta["files"][name] = {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    change(meta)
    write_anew(folder / META, json.dumps(meta | {"digest": digest(meta)}).encode())


def of_meta(change: Callable[[Tree], Any]) -> Callable[[Path], None]:
    """Return a change of the facts of a sealed scene."""
    return lambda folder: seal(folder, change)


def of_index(change: Callable[[Tree], Any]) -> Callable[[Path], None]:
    """Return a change of the index of a sealed scene."""

    def make(folder: Path) -> None:
        index = json.loads((folder / INDEX).read_text())
        change(index)
        write_anew(folder / INDEX, json.dumps(index).encode())
        seal(folder)

    return make


def of_rig(old: str, new: str) -> Callable[[Path], None]:
    """Return a change of the rig of a sealed scene."""

    def make(folder: Path) -> None:
        text = (folder / "rig.yaml").read_text()
        assert old in text
        write_anew(folder / "rig.yaml", text.replace(old, new, 1).encode())
        seal(folder)

    return make


def of_blob(member: str, new: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Return a change of a member of the first frame of a sealed scene, written as all others are."""

    def make(folder: Path) -> None:
        scene = SceneFolder(folder)
        members, index = scene.index.members, json.loads((folder / INDEX).read_text())
        frames = [scene.read(frame, members) for frame in range(len(scene))]
        frames[0] = {name: new(blob) if name == member else blob for name, blob in frames[0].items()}
        writer = SceneWriter(folder.with_name("rewritten"))
        for blobs, row in zip(frames, index["frames"], strict=True):
            writer.append(blobs, row["entry"])
        writer.finish({})
        for name in (SHARD, INDEX):
            write_anew(folder / name, (folder.with_name("rewritten") / name).read_bytes())
        for path in folder.with_name("rewritten").iterdir():
            path.unlink()
        folder.with_name("rewritten").rmdir()
        seal(folder)

    return make


def _facts(change: Callable[[Tree], Any]) -> Callable[[bytes], bytes]:
    def new(blob: bytes) -> bytes:
        facts = json.loads(blob)
        change(facts)
        return json.dumps(facts).encode()

    return new


def _put(*way: Any, value: Any) -> Callable[[Tree], None]:
    """Return a change of the value at a place of a tree."""

    def change(tree: Any) -> None:
        for key in way[:-1]:
            tree = tree[key]
        tree[way[-1]] = copy.deepcopy(value)

    return change


def _first(key: str, value: Any) -> Callable[[Tree], None]:
    return _put("frames", 0, key, value=value)


def _member(key: str, value: int) -> Callable[[Tree], None]:
    return _put("frames", 0, key, 1, value=value)


def _image(width: int, height: int, suffix: str = ".jpg") -> Callable[[bytes], bytes]:
    return lambda blob: cv2.imencode(suffix, np.zeros((height, width, 3), np.uint8))[1].tobytes()


def _jpeg_of_gigabytes(blob: bytes) -> bytes:
    """Return a JPEG whose header says that it has 65,500 by 65,500 px."""
    at = blob.index(b"\xff\xc0") + 5
    return blob[:at] + (65500).to_bytes(2, "big") * 2 + blob[at + 4 :]


def _zeros_of_gigabytes(blob: bytes) -> bytes:
    """Return kilobytes that zstd unpacks to eight gigabytes, without their size in the header."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join([*(packer.compress(bytes(2**24)) for _ in range(512)), packer.flush()])


def _zeros_with_size(blob: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(bytes(2**31))


def _claims_gigabytes(blob: bytes) -> bytes:
    """Return a zstd frame whose header says 2**60 bytes."""
    return b"\x28\xb5\x2f\xfd" + b"\xe0" + (2**60).to_bytes(8, "little") + b"\x01\x00\x00"


def _labels(value: int, height: int = 36, width: int = 64) -> Callable[[bytes], bytes]:
    return lambda blob: pack(np.full((height, width), value, np.uint8))


NAN_POSE = [[float("nan")] * 4] * 4
FLAT_POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]
SEALED: dict[str, tuple[str, Callable[[Path], None]]] = {
    "frames-more": ("refused", of_meta(_put("frames", value=10**9))),
    "frames-negative": ("refused", of_meta(_put("frames", value=-3))),
    "frames-few": ("refused", of_meta(_put("frames", value=1))),
    "frames-a-text": ("refused", of_meta(_put("frames", value="3"))),
    "frames-null": ("refused", of_meta(_put("frames", value=None))),
    "schema-other": ("refused", of_meta(_put("schema", value=99))),
    "schema-missing": ("refused", of_meta(lambda meta: meta.pop("schema"))),
    "files-missing": ("refused", of_meta(lambda meta: meta.pop("files"))),
    "files-a-list": ("refused", of_meta(_put("files", value=[1]))),
    "files-outward": (
        "either",
        of_meta(_put("files", "../../../neighbour/notes.txt", value={"size": 1, "sha256": "0"})),
    ),
    "facts-missing": ("refused", of_meta(lambda meta: meta.pop("facts"))),
    "spec-missing": ("refused", of_meta(lambda meta: meta["facts"].pop("spec"))),
    "spec-a-text": ("refused", of_meta(_put("facts", "spec", value="virtual"))),
    "classes-a-list": ("refused", of_meta(_put("facts", "spec", "classes", value=[1, 2]))),
    "classes-few": ("refused", of_meta(lambda meta: meta["facts"]["spec"]["classes"].pop("3"))),
    "class-id-huge": (
        "refused",
        of_meta(_put("facts", "spec", "classes", "999999999", value={"name": "a", "rgb": [1, 1, 1]})),
    ),
    "class-id-text": ("refused", of_meta(_put("facts", "spec", "classes", "a", value={"name": "a", "rgb": [1, 1, 1]}))),
    "class-name-a-number": ("refused", of_meta(_put("facts", "spec", "classes", "1", "name", value=7))),
    "class-name-twice": ("refused", of_meta(_put("facts", "spec", "classes", "1", "name", value="Wall"))),
    "class-colour-huge": ("refused", of_meta(_put("facts", "spec", "classes", "1", "rgb", value=[999, -1, 0]))),
    "class-colour-texts": ("refused", of_meta(_put("facts", "spec", "classes", "1", "rgb", value=["a", "b", "c"]))),
    "edges-nan": ("refused", of_meta(_put("facts", "spec", "range_edges_m", value=[float("nan")] * 3))),
    "edges-falling": ("refused", of_meta(_put("facts", "spec", "range_edges_m", value=[25.0, 8.0, 0.0]))),
    "edges-a-text": ("refused", of_meta(_put("facts", "spec", "range_edges_m", value="near"))),
    "interval-nothing": ("refused", of_meta(_put("facts", "spec", "frame_interval_s", value=0))),
    "interval-a-text": ("refused", of_meta(_put("facts", "spec", "frame_interval_s", value="0.5"))),
    "road-nan": ("refused", of_meta(_put("facts", "spec", "road_z_m", value=float("nan")))),
    "road-a-list": ("refused", of_meta(_put("facts", "spec", "road_z_m", value=[-2.2]))),
    "panorama-texts": ("refused", of_meta(_put("facts", "panorama_edges_deg", value=["a", "b"]))),
    "panorama-turned-over": ("refused", of_meta(_put("facts", "panorama_edges_deg", value=[-45.0, 45.0]))),
    "panorama-nan": ("refused", of_meta(_put("facts", "panorama_edges_deg", value=[float("nan"), -45.0]))),
    "index-no-frames": ("refused", of_index(lambda index: index.pop("frames"))),
    "index-frames-few": ("refused", of_index(lambda index: index["frames"].pop())),
    "index-offset-negative": ("refused", of_index(_member("offset", -512))),
    "index-offset-far": ("refused", of_index(_member("offset", 2**62))),
    "index-offset-overflows": ("refused", of_index(_member("offset", 2**80))),
    "index-size-negative": ("refused", of_index(_member("size", -1))),
    "index-size-huge": ("refused", of_index(_member("size", 2**31 - 1))),
    "index-size-overflows": ("refused", of_index(_member("size", 2**40))),
    "index-crc-negative": ("refused", of_index(_member("crc32", -1))),
    "index-shard-negative": ("refused", of_index(_first("shard", -1))),
    "index-shard-missing": ("refused", of_index(_first("shard", 77))),
    "index-shard-a-text": ("refused", of_index(_first("shard", "../../../neighbour/notes.txt"))),
    "index-members-twice": ("refused", of_index(_put("members", 2, value="rgb0.jpg"))),
    "index-members-outward": ("refused", of_index(_put("members", 1, value="../../rgb0.jpg"))),
    "index-members-few": ("refused", of_index(lambda index: index["members"].pop(1))),
    "index-members-numbers": ("refused", of_index(_put("members", 1, value=7))),
    "index-time-nan": ("refused", of_index(_put("frames", 1, "entry", "time_s", value=float("nan")))),
    "index-time-backwards": ("refused", of_index(_put("frames", 1, "entry", "time_s", value=-9.0))),
    "index-time-a-text": ("refused", of_index(_put("frames", 1, "entry", "time_s", value="late"))),
    "index-pose-nan": ("refused", of_index(_put("frames", 1, "entry", "world_from_ego", value=NAN_POSE))),
    "index-pose-flat": ("refused", of_index(_put("frames", 1, "entry", "world_from_ego", value=FLAT_POSE))),
    "index-pose-three-rows": ("refused", of_index(_put("frames", 1, "entry", "world_from_ego", value=FLAT_POSE[:3]))),
    "index-pose-missing": ("refused", of_index(lambda index: index["frames"][1]["entry"].pop("world_from_ego"))),
    "index-entry-missing": ("refused", of_index(_put("frames", 1, "entry", value={}))),
    "rig-focal-nan": ("refused", of_rig("focal_px: ", "focal_px: .nan #")),
    "rig-camera-left-out": ("refused", of_rig("front_right:", "front:")),
    "rig-mask-outward": ("refused", of_rig("mask: rig.front.png", "mask: ../../../neighbour/notes.txt")),
    "rig-other-size": ("refused", of_rig("width: 64", "width: 48")),
    "rig-camera-named-outward": ("either", of_rig("  front:", "  ../../../neighbour/x:")),
    "image-other-size": ("refused", of_blob("rgb0.jpg", _image(32, 18))),
    "image-of-gigabytes": ("refused", of_blob("rgb0.jpg", _jpeg_of_gigabytes)),
    "image-large": ("refused", of_blob("rgb0.jpg", _image(9000, 9000, ".png"))),
    "image-empty": ("refused", of_blob("rgb0.jpg", lambda blob: b"")),
    "image-text": ("refused", of_blob("rgb0.jpg", lambda blob: b"no image")),
    "labels-bomb": ("refused", of_blob("semantic0.zst", _zeros_of_gigabytes)),
    "labels-bomb-with-size": ("refused", of_blob("semantic0.zst", _zeros_with_size)),
    "labels-claim-gigabytes": ("refused", of_blob("semantic0.zst", _claims_gigabytes)),
    "labels-unknown-class": ("refused", of_blob("semantic0.zst", _labels(200))),
    "labels-other-size": ("refused", of_blob("semantic0.zst", _labels(1, 18, 32))),
    "labels-empty": ("refused", of_blob("semantic0.zst", lambda blob: b"")),
    "ranges-of-bytes": ("refused", of_blob("range0.zst", _labels(1))),
    "ranges-other-size": ("refused", of_blob("range0.zst", lambda blob: pack(np.ones((9, 9), np.uint16)))),
    "panorama-empty": ("refused", of_blob(PANORAMA, lambda blob: b"")),
    "panorama-of-one-pixel": ("refused", of_blob(PANORAMA, lambda blob: pack(np.ones((1, 1), np.uint16)))),
    "points-bomb": ("refused", of_blob(POINTS, _zeros_of_gigabytes)),
    "points-odd": ("refused", of_blob(POINTS, lambda blob: zstandard.ZstdCompressor().compress(bytes(10)))),
    "points-unknown-class": (
        "refused",
        of_blob(POINTS, lambda blob: zstandard.ZstdCompressor().compress(bytes(60) + b"\xc8" * 10)),
    ),
    "points-none": ("either", of_blob(POINTS, lambda blob: zstandard.ZstdCompressor().compress(b""))),
    "lidar-few": ("refused", of_blob(LIDAR, lambda blob: zstandard.ZstdCompressor().compress(bytes(9)))),
    "lidar-unknown-class": (
        "refused",
        of_blob(LIDAR, lambda blob: zstandard.ZstdCompressor().compress(b"\x01" * 28080 + b"\xc8" * 14040)),
    ),
    "frame-no-json": ("either", of_blob(FACTS, lambda blob: b"{")),
    "frame-deep": ("either", of_blob(FACTS, lambda blob: b"[" * 100_000)),
    "boxes-a-number": ("either", of_blob(FACTS, _facts(_put("boxes", value=7)))),
    "boxes-of-nothing": ("either", of_blob(FACTS, _facts(_put("boxes", value=[{}])))),
    "boxes-nan": (
        "either",
        of_blob(
            FACTS,
            _facts(
                _put(
                    "boxes",
                    value=[
                        {
                            "id": 1,
                            "label": 7,
                            "center_m": [float("nan")] * 3,
                            "size_m": [1, 1, 1],
                            "yaw_rad": 0,
                            "velocity_mps": [0, 0, 0],
                        }
                    ],
                )
            ),
        ),
    ),
}
"""What the check must say, and the change; checksums are right, as a hostile writer would have them."""
TEXTS = {
    "meta-deep": (META, b'{"a":' * 100_000),
    "meta-a-list": (META, b"[]"),
    "meta-number": (META, b"NaN"),
    "meta-not-utf8": (META, b'{"a": "\xff"}'),
    "index-deep": (INDEX, b"[" * 200_000),
    "index-a-list": (INDEX, b"[]"),
    "meta-long-number": (META, b'{"schema": 1' + b"0" * 5000 + b"}"),
}


def _crc(folder: Path, rng: random.Random) -> None:
    """Change a byte of an image and its checksum in the tar's index, but not that of the shard."""
    index = json.loads((folder / INDEX).read_text())
    row = index["frames"][0]
    begin, size = row["offset"][1], row["size"][1]
    content = bytearray((folder / SHARD).read_bytes())
    content[begin + size // 2] ^= 0xFF
    row["crc32"][1] = zlib.crc32(content[begin : begin + size])
    write_anew(folder / SHARD, bytes(content))
    write_anew(folder / INDEX, json.dumps(index).encode())


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = []

    def add(name: str, expect: str, names: tuple[str, ...], change: Callable[[Path], Any]) -> None:
        drawn = rng.random()

        def make(box: Box) -> list[Opening]:
            change(copied(box))
            made = openings(box, names, expect, drawn)
            return [Opening(one.command, "right", one.names) for one in made] if name == "sound" else made

        found.append(Case(KIND, name, make))

    add("sound", "right", (SHARD,), lambda folder: None)
    for name, (expect, change) in SEALED.items():
        add(f"sealed-{name}", expect, (SHARD, META, INDEX, "rig.yaml"), change)
    for name, (file, text) in TEXTS.items():
        add(name, "refused", (file,), lambda folder, file=file, text=text: write_anew(folder / file, text))
    add("checksum-of-member-alone", "refused", (INDEX,), lambda folder: _crc(folder, rng))
    for file in (META, INDEX, SHARD, "rig.yaml", "rig.front.png"):
        for name in (*rng.sample(sorted(BROKEN), 3), *rng.sample(sorted(DAMAGED), 2)):
            drawn = rng.random()
            # every member has a checksum; what stands between them is not read
            expect = "either" if file == SHARD and name in DAMAGED else "refused"
            add(
                f"{file}-{name}",
                expect,
                (file,),
                lambda folder, file=file, name=name, drawn=drawn: (BROKEN | DAMAGED)[name](
                    folder / file, random.Random(drawn)
                ),
            )
    return found
