"""Forge files of LiDAR points, which a log is made into a scene with."""

import io
import pickle
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from forge_checkpoints import Reduced, touch
from forge_poses import record
from log_files import lidar_option, write_pcd, write_ply
from mutate import BROKEN, DAMAGED, linked_copy
from sandbox import Box, Case, Opening

from omniocc.data.store.reader import SceneReader

KIND = "point clouds"
Text = Callable[[bytes], bytes]
KINDS = ("bin", "label", "pcd", "ply", "npz", "npy")


def same_points(base: Path) -> Callable[[Path, str], str | None]:
    """Return a check that the recorded points are those of the sound file."""

    def check(out: Path, text: str) -> str | None:
        scenes = (SceneReader(place / "test-000-log").points(0) for place in (out / "result", base / "recorded-cloud"))
        ours, right = (None if points is None else np.unique(points.points_m, axis=0) for points in scenes)
        if ours is None or right is None or ours.shape != right.shape or not np.array_equal(ours, right):
            return (
                f"{0 if ours is None else len(ours)} points, not the {0 if right is None else len(right)} of the file"
            )
        return None

    return check


def opened(box: Box, kind: str, change: Callable[[Path], Any], right: str, label: str) -> list[Opening]:
    """Change the scan of a log, and return the command that reads it."""
    log = linked_copy(box.base / "short", box.given / "log")
    folder = "bin" if kind == "label" else kind
    scan = next(path for path in (log / "npz").iterdir())
    if kind == "npy":
        (log / "npy").mkdir()
        np.save(log / "npy" / f"{scan.stem}.npy", np.load(scan)["points"])
    path = log / folder / f"{scan.stem}.{kind}"
    assert path.is_file()
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)
    change(path)
    command = record(box, log, f"recorder.{lidar_option(folder)}")
    check = same_points(box.base) if right == "right" else None
    names = (path.name, "hardly any points")
    if kind in ("bin", "npy"):
        names += (path.with_suffix(".label").name, f"lidar.folder={folder}")  # the file beside; no scan at all
    return [Opening(command, right, names, check)]


def _text(*changes: tuple[bytes, bytes]) -> Callable[[Path, Box], None]:
    """Return a change of bytes, the first of each."""

    def change(path: Path, box: Box) -> None:
        content = path.read_bytes()
        for old, new in changes:
            assert old in content, old
            content = content.replace(old, new, 1)
        path.write_bytes(content)

    return change


def _points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with np.load(path.parent.parent / "npz" / f"{path.stem}.npz") as content:
        return content["points"], content["labels"]


def _as(kind: str, encoding: str, *changes: tuple[bytes, bytes]) -> Callable[[Path, Box], None]:
    """Return a change that writes the sound points in another encoding, then changes bytes."""

    def change(path: Path, box: Box) -> None:
        (write_pcd if kind == "pcd" else write_ply)(path, *_points(path), encoding)
        _text(*changes)(path, box)

    return change


def _npz(new: Callable[[np.ndarray, np.ndarray], dict[str, Any]], **options: Any) -> Callable[[Path, Box], None]:
    return lambda path, box: np.savez(path, **options, **new(*_points(path)))


def _npz_member(path: Path, shape: str, dtype: str, body: bytes = b"", name: str = "points.npy") -> None:
    """Write an npz whose header of an array says what its body does not hold."""
    header = f"{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body)


def _npz_bomb(path: Path, box: Box) -> None:
    """Write an npz of kilobytes whose array takes six gigabytes."""
    rows = 2**29
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (rows, 3)})
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("points.npy", "w", force_zip64=True) as member,
    ):
        member.write(head.getvalue())
        for _ in range(256):  # the rest is missing, which is seen only after the memory was taken
            member.write(bytes(2**20))


def _pickled(path: Path, box: Box) -> None:
    evil = np.array([Reduced(touch(box, "unpickled"))], dtype=object)
    if path.suffix == ".npy":
        np.save(path, evil, allow_pickle=True)
    else:
        np.savez(path, points=evil, labels=evil)


PCD, PLY, NPZ = "pcd", "ply", "npz"
HEADER = b"FIELDS x y z intensity label\nSIZE 4 4 4 4 2\nTYPE F F F F U\nCOUNT 1 1 1 1 1\n"
SPECIFIC: dict[str, tuple[str, str, Callable[[Path, Box], Any]]] = {
    "pcd-ascii": (PCD, "right", _as(PCD, "ascii")),
    "pcd-binary": (PCD, "right", _as(PCD, "binary")),
    "pcd-points-huge": (PCD, "refused", _as(PCD, "binary", (b"POINTS 6000", b"POINTS 600000000000"))),
    "pcd-points-negative": (PCD, "refused", _as(PCD, "binary", (b"POINTS ", b"POINTS -"))),
    "pcd-points-of-5000-digits": (PCD, "refused", _as(PCD, "binary", (b"POINTS ", b"POINTS 1" + b"0" * 5000))),
    "pcd-points-other-digits": (PCD, "refused", _as(PCD, "binary", (b"POINTS ", "POINTS ²".encode()))),
    "pcd-points-few": (PCD, "refused", _as(PCD, "binary", (b"POINTS 6000", b"POINTS 10"))),
    "pcd-width-other": (PCD, "refused", _as(PCD, "binary", (b"WIDTH 6000", b"WIDTH 77"))),
    "pcd-count-huge": (PCD, "refused", _as(PCD, "binary", (b"COUNT 1 1 1 1 1", b"COUNT 1 1 1 99999999999 1"))),
    "pcd-count-nothing": (PCD, "refused", _as(PCD, "binary", (b"COUNT 1 1 1 1 1", b"COUNT 0 0 0 0 0"))),
    "pcd-count-of-x": (PCD, "refused", _as(PCD, "binary", (b"COUNT 1 1 1 1 1", b"COUNT 2 1 1 1 1"))),
    "pcd-size-three": (PCD, "refused", _as(PCD, "binary", (b"SIZE 4", b"SIZE 3"))),
    "pcd-size-empty": (PCD, "refused", _as(PCD, "binary", (b"SIZE 4 4 4 4 2", b"SIZE 4 4 4 4 48"))),
    "pcd-type-other": (PCD, "refused", _as(PCD, "binary", (b"TYPE F", b"TYPE X"))),
    "pcd-type-long": (PCD, "refused", _as(PCD, "binary", (b"TYPE F F", b"TYPE FI F"))),
    "pcd-twice-x": (PCD, "refused", _as(PCD, "binary", (b"FIELDS x y z", b"FIELDS x x z"))),
    "pcd-no-z": (PCD, "refused", _as(PCD, "binary", (b"FIELDS x y z", b"FIELDS x y a"))),
    "pcd-twice-points": (PCD, "refused", _as(PCD, "binary", (b"DATA binary", b"POINTS 10\nDATA binary"))),
    "pcd-big-x": (PCD, "refused", _as(PCD, "binary", (b"TYPE F F F F U", b"TYPE I F F F U"))),
    "pcd-data-other": (PCD, "refused", _as(PCD, "binary", (b"DATA binary", b"DATA zipped"))),
    "pcd-ascii-overflow": (PCD, "refused", _as(PCD, "ascii", (b"DATA ascii\n", b"DATA ascii\n1e400 "))),
    "pcd-ascii-short": (PCD, "refused", _as(PCD, "ascii", (b"POINTS 6000", b"POINTS 6001"))),
    "pcd-ascii-words": (PCD, "refused", _as(PCD, "ascii", (b"DATA ascii\n", b"DATA ascii\nleft "))),
    "pcd-whole-huge": (PCD, "refused", lambda path, box: _sizes(path, whole=2**32 - 1)),
    "pcd-packed-huge": (PCD, "refused", lambda path, box: _sizes(path, packed=2**32 - 1)),
    "pcd-packed-nothing": (PCD, "refused", lambda path, box: _sizes(path, packed=0)),
    "pcd-reference-before-begin": (PCD, "refused", lambda path, box: _undo_lzf(path, b"\x20\xff" * 2000)),
    "pcd-reference-cut": (PCD, "refused", lambda path, box: _undo_lzf(path, b"\x00\x01\xe0")),
    "ply-ascii": (PLY, "right", _as(PLY, "ascii")),
    "ply-binary": (PLY, "right", _as(PLY, "binary_little_endian")),
    "ply-big-endian": (PLY, "refused", _text((b"binary_little_endian", b"binary_big_endian"))),
    "ply-vertices-huge": (PLY, "refused", _text((b"vertex 6000", b"vertex 99999999999999"))),
    "ply-vertices-negative": (PLY, "refused", _text((b"vertex 6000", b"vertex -1"))),
    "ply-vertices-few": (PLY, "refused", _text((b"vertex 6000", b"vertex 10"))),
    "ply-vertex-without-count": (PLY, "refused", _text((b"vertex 6000", b"vertex"))),
    "ply-element-without-name": (PLY, "refused", _text((b"element vertex 6000", b"element"))),
    "ply-list-of-vertices": (PLY, "refused", _text((b"property float x", b"property list uchar int x"))),
    "ply-twice-x": (PLY, "refused", _text((b"property float y", b"property float x"))),
    "ply-no-format": (PLY, "refused", _text((b"format binary_little_endian 1.0\n", b""))),
    "ply-type-other": (PLY, "refused", _text((b"property float x", b"property quad x"))),
    "ply-header-unclosed": (PLY, "refused", _text((b"end_header\n", b""))),
    "ply-ascii-nan-label": (PLY, "refused", _as(PLY, "ascii", (b"end_header\n", b"end_header\n1 2 3 0 nan\n"))),
    "npz-float64": (NPZ, "right", _npz(lambda p, k: {"points": p.astype(np.float64), "labels": k})),
    "npz-big-endian": (NPZ, "right", _npz(lambda p, k: {"points": p.astype(">f4"), "labels": k.astype(">i8")})),
    "npz-fortran-order": (NPZ, "right", _npz(lambda p, k: {"points": np.asfortranarray(p), "labels": k})),
    "npz-further-columns": (NPZ, "right", _npz(lambda p, k: {"points": np.c_[p, p], "labels": k})),
    "npz-transposed": (NPZ, "refused", _npz(lambda p, k: {"points": p.T, "labels": k})),
    "npz-two-columns": (NPZ, "refused", _npz(lambda p, k: {"points": p[:, :2], "labels": k})),
    "npz-complex": (NPZ, "refused", _npz(lambda p, k: {"points": p.astype(np.complex64), "labels": k})),
    "npz-texts": (NPZ, "refused", _npz(lambda p, k: {"points": p.astype(str), "labels": k})),
    "npz-truths": (NPZ, "refused", _npz(lambda p, k: {"points": p > 0, "labels": k})),
    "npz-dates": (NPZ, "refused", _npz(lambda p, k: {"points": p.astype("datetime64[s]"), "labels": k})),
    "npz-records": (NPZ, "refused", _npz(lambda p, k: {"points": p.copy().view("f4,f4,f4"), "labels": k})),
    "npz-labels-few": (NPZ, "refused", _npz(lambda p, k: {"points": p, "labels": k[:-1]})),
    "npz-labels-nan": (NPZ, "refused", _npz(lambda p, k: {"points": p, "labels": np.full(len(p), np.nan)})),
    "npz-labels-fractions": (NPZ, "refused", _npz(lambda p, k: {"points": p, "labels": k + 0.5})),
    "npz-labels-huge": (NPZ, "either", _npz(lambda p, k: {"points": p, "labels": np.full(len(p), 1e30)})),
    "npz-labels-texts": (NPZ, "refused", _npz(lambda p, k: {"points": p, "labels": k.astype(str)})),
    "npz-labels-negative": (NPZ, "either", _npz(lambda p, k: {"points": p, "labels": -k.astype(int)})),
    "npz-no-points": (NPZ, "refused", _npz(lambda p, k: {"labels": k})),
    "npz-all-nan": (NPZ, "refused", _npz(lambda p, k: {"points": p * np.nan, "labels": k})),
    "npz-overflows": (NPZ, "refused", _npz(lambda p, k: {"points": p.astype(float) * 1e300, "labels": k})),
    "npz-a-number": (NPZ, "refused", _npz(lambda p, k: {"points": np.float32(3)})),
    "npz-pickle": (NPZ, "refused", _pickled),
    "npz-bomb": (NPZ, "refused", _npz_bomb),
    "npz-shape-huge": (NPZ, "refused", lambda path, box: _npz_member(path, "(99999999999999, 3)", "'<f4'")),
    "npz-shape-negative": (NPZ, "refused", lambda path, box: _npz_member(path, "(-4, 3)", "'<f4'", bytes(48))),
    "npz-shape-of-code": (
        NPZ,
        "refused",
        lambda path, box: _npz_member(path, f"(open({str(box.marks / 'a')!r}, 'w'), 3)", "'<f4'"),
    ),
    "npz-dtype-object": (NPZ, "refused", lambda path, box: _npz_member(path, "(1, 3)", "'|O'", pickle.dumps([1]))),
    "npz-outward": (NPZ, "refused", lambda path, box: _npz_member(path, "(1, 3)", "'<f4'", bytes(12), "../points.npy")),
    "npy-sound": ("npy", "either", lambda path, box: None),
    "npy-pickle": ("npy", "refused", _pickled),
    "npy-of-text": ("npy", "refused", lambda path, box: np.save(path, np.array(["a"]))),
    "npy-flat": ("npy", "refused", lambda path, box: np.save(path, np.ones(30, np.float32))),
    "bin-float64": ("bin", "refused", lambda path, box: np.fromfile(path, "<f4").astype("<f8").tofile(path)),
    "bin-big-endian": ("bin", "refused", lambda path, box: np.fromfile(path, "<f4").astype(">f4").tofile(path)),
    "bin-five-columns": (
        "bin",
        "refused",
        lambda path, box: np.c_[_points(path)[0], np.ones((6000, 2))].astype("<f4").tofile(path),
    ),
    "bin-all-nan": ("bin", "refused", lambda path, box: np.full((6000, 4), np.nan, "<f4").tofile(path)),
    "label-few": ("label", "refused", lambda path, box: path.write_bytes(path.read_bytes()[:-4])),
    "label-of-bytes": ("label", "refused", lambda path, box: np.zeros(6000, np.uint8).tofile(path)),
}
"""Kind, what has to come of it, and the change."""


def _sizes(path: Path, packed: int | None = None, whole: int | None = None) -> None:
    """Change the two sizes that precede compressed points."""
    content = bytearray(path.read_bytes())
    begin = content.index(b"DATA binary_compressed\n") + len(b"DATA binary_compressed\n")
    for offset, value in ((0, packed), (4, whole)):
        if value is not None:
            content[begin + offset : begin + offset + 4] = value.to_bytes(4, "little")
    path.write_bytes(bytes(content))


def _undo_lzf(path: Path, packed: bytes) -> None:
    """Replace the compressed points."""
    content = path.read_bytes()
    begin = content.index(b"DATA binary_compressed\n") + len(b"DATA binary_compressed\n")
    path.write_bytes(content[:begin] + len(packed).to_bytes(4, "little") + content[begin + 4 : begin + 8] + packed)


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = []
    for name, (kind, right, change) in SPECIFIC.items():

        def make(box: Box, name=name, kind=kind, right=right, change=change) -> list[Opening]:
            return opened(box, kind, lambda path: change(path, box), right, name)

        found.append(Case(KIND, name, make))
    for kind in KINDS:
        for name in (*rng.sample(sorted(BROKEN), 5), *rng.sample(sorted(DAMAGED), 3)):
            seed_of_file = rng.random()

            def make_damaged(box: Box, kind=kind, name=name, seed=seed_of_file) -> list[Opening]:
                mutation = (BROKEN | DAMAGED)[name]
                right = "refused" if name in BROKEN and (kind, name) != ("label", "nul-bytes") else "either"
                return opened(box, kind, lambda path: mutation(path, random.Random(seed)), right, name)

            found.append(Case(KIND, f"{kind}-{name}", make_damaged))
    return found
