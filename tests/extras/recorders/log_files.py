"""Write a recorded scene as other tools would: folders of files with time stamps, clouds in several formats."""

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from omegaconf import OmegaConf

from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.config import build, check
from omniocc.data import SceneReader
from omniocc.data.source.recorded import spec_of

ROOT = Path(__file__).parents[3]

START_NS = 1_700_000_000_123_456_789
EGO_FROM_LIDAR = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, -0.25], [0, 0, 1, 0.75], [0, 0, 0, 1]])
"""A quarter turn to the left, and binary fractions: the way there and back costs no more than float32."""
POSE_OPTION = "{position_m: [0.5, -0.25, 0.75], quaternion_wxyz: [0.7071067811865476, 0, 0, 0.7071067811865476]}"


def built(option: str, *overrides: str) -> Any:
    """Return the recorder that an option of `conf/recorder` describes, with `key=value` as on the command line."""
    cfg = OmegaConf.load(ROOT / "conf" / "recorder" / f"{option}.yaml")
    for override in overrides:
        key, _, value = override.partition("=")
        cfg[key] = yaml.safe_load(value)
    check(cfg)
    return build(cfg)


def stamp_ns(scene: SceneReader, frame: int, late_ns: int = 0) -> int:
    return START_NS + round(scene.time_s[frame] * 1e9) + late_ns


def lidar_points(scene: SceneReader, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a frame in the frame of the LiDAR, float32, and their classes."""
    points = scene.points(frame)
    return (points.points_m - EGO_FROM_LIDAR[:3, 3]).astype(np.float32) @ EGO_FROM_LIDAR[:3, :3].astype(
        np.float32
    ), points.labels


def rig_of(scene: SceneReader) -> Rig:
    """Return the rig of the scene, which then states the height of the road."""
    return replace(scene.rig, road_z_m=spec_of(scene).road_z_m)


def write_log(scene: SceneReader, folder: Path) -> Path:
    rig_of(scene).save(folder / "rig.yaml")
    for name in scene.rig.names:
        (folder / name).mkdir()
    for kind in ("npz", "bin", "pcd", "ply"):
        (folder / kind).mkdir()
    rows = []
    for frame in range(len(scene)):
        for k, (name, image) in enumerate(zip(scene.rig.names, scene.images(frame), strict=True)):
            path = folder / name / f"{stamp_ns(scene, frame, 1_000_000 * k)}.png"
            assert cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        rows.append([stamp_ns(scene, frame), *scene.world_from_ego[frame].ravel().tolist()])
        points, labels = lidar_points(scene, frame)
        stem = str(stamp_ns(scene, frame))
        np.savez(folder / "npz" / f"{stem}.npz", points=points, labels=labels)
        write_bin(folder / "bin" / f"{stem}.bin", points, labels)
        write_pcd(folder / "pcd" / f"{stem}.pcd", points, labels)
        write_ply(folder / "ply" / f"{stem}.ply", points, labels)
    (folder / "poses.csv").write_text("time,matrix\n" + "\n".join(",".join(map(repr, row)) for row in rows) + "\n")
    names = {row.id: row.name for row in WORLD_CLASSES.rows if row.id} | {255: "unknown"}
    (folder / "classes.yaml").write_text(yaml.safe_dump(names))
    return folder


def lidar_option(kind: str, *more: str) -> str:
    parts = [f"folder: {kind}", f"ego_from_lidar: {POSE_OPTION}", *more]
    return f"lidar={{{', '.join(parts)}}}"


def write_bin(path: Path, points: np.ndarray, labels: np.ndarray) -> None:
    np.column_stack([points, np.zeros(len(points))]).astype("<f4").tofile(path)
    (labels.astype("<u4") | np.uint32(7 << 16)).tofile(path.with_suffix(".label"))


def table_of(points: np.ndarray, labels: np.ndarray) -> np.ndarray:
    table = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("label", "<u2")])
    table["x"], table["y"], table["z"] = points.T
    table["label"] = labels
    return table


def write_pcd(path: Path, points: np.ndarray, labels: np.ndarray, encoding: str = "binary_compressed") -> None:
    table = table_of(points, labels)
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity label\nSIZE 4 4 4 4 2\nTYPE F F F F U\nCOUNT 1 1 1 1 1\n"
        f"WIDTH {len(table)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\nDATA {encoding}\n"
    )
    if encoding == "ascii":
        body = text_of(table)
    elif encoding == "binary":
        body = table.tobytes()
    else:
        whole = b"".join(table[name].tobytes() for name in table.dtype.names)
        packed = compressed(whole)
        body = struct.pack("<II", len(packed), len(whole)) + packed
    path.write_bytes(header.encode() + body)


def write_ply(path: Path, points: np.ndarray, labels: np.ndarray, encoding: str = "binary_little_endian") -> None:
    table = table_of(points, labels)
    header = f"ply\nformat {encoding} 1.0\ncomment by a test\nelement vertex {len(table)}\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    header += "property ushort label\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(header.encode() + (text_of(table) if encoding == "ascii" else table.tobytes()))


def text_of(table: np.ndarray) -> bytes:
    rows = (" ".join(repr(float(v)) if isinstance(v, np.floating) else str(v) for v in row) for row in table)
    return ("\n".join(rows) + "\n").encode()


def compressed(whole: bytes) -> bytes:
    """Return LZF-compressed bytes: runs of one byte as references one byte back, all else as literals."""
    result, place = bytearray(), 0
    literals = bytearray()

    def flush() -> None:
        for start in range(0, len(literals), 32):
            part = literals[start : start + 32]
            result.append(len(part) - 1)
            result.extend(part)
        literals.clear()

    while place < len(whole):
        run = 1
        while place + run < len(whole) and whole[place + run] == whole[place] and run < 200:
            run += 1
        literals.append(whole[place])
        if run >= 4:
            flush()
            length = run - 3  # the reference repeats the literal run - 1 times; two are added to its length
            result.extend([min(length, 7) << 5, *([length - 7] if length >= 7 else []), 0])
            place += run
        else:
            place += 1
    flush()
    return bytes(result)


CLASSES = "classes: classes.yaml"
NPZ = lidar_option("npz", CLASSES)


def record(recorder, root, *overrides) -> SceneReader:
    (folder,) = recorder(*overrides).record(root)
    return SceneReader(folder)


def first_image(log, original, camera=1, frame=1):
    return sorted((log / original.rig.names[camera]).iterdir())[frame]


def rewrite(log, change, frames=None):
    """Replace the points of the scans `npz` of a log, all or the first ones, by a function of points and labels."""
    for path in sorted((log / "npz").iterdir())[:frames]:
        with np.load(path) as content:
            points, labels = change(content["points"], content["labels"])
        np.savez(path, points=points, labels=labels)
