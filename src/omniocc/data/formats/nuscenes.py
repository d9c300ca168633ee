"""The tables of nuScenes (and of data sets in its schema): key frames, cameras, poses.

Format: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md
"""

import json
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from omniocc.data.formats.poses import inverse, quaternion_pose
from omniocc.errors import FAULTS, DataError, first_line, repr_of
from omniocc.io import checked_name, object_of_pairs, twice
from omniocc.progress import Progress

CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
LIDAR = "LIDAR_TOP"
Rows = dict[str, dict[str, Any]]
Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")
CHUNK_BYTES = 1 << 22
MIB = 1 << 20

VALIDATION = (
    (3, 3),
    (12, 18),
    (35, 36),
    (38, 39),
    (92, 110),
    (221, 221),
    (268, 278),
    (329, 332),
    (344, 346),
    (519, 524),
    (552, 565),
    (625, 627),
    (629, 630),
    (632, 638),
    (770, 771),
    (775, 775),
    (777, 778),
    (780, 784),
    (794, 800),
    (802, 802),
    (904, 917),
    (919, 931),
    (962, 963),
    (966, 969),
    (971, 972),
    (1059, 1073),
)
"""First and last numbers of the 150 official validation scenes (nuscenes-devkit, utils/splits.py, `val`)."""


def is_validation(scene: str) -> bool:
    """Return whether a scene ('scene-0103') is one of the 150 official validation scenes."""
    number = int(scene.rsplit("-", 1)[1]) if scene.rsplit("-", 1)[-1].isdigit() else -1
    return any(first <= number <= last for first, last in VALIDATION)


class KeyFrames(NamedTuple):
    """The key frames of one scene, in the order of time.

    Attributes:
        tokens: of the samples.
        time_us: time stamp of the LiDAR's sample_data, microseconds.
        world_from_ego: pose of the car at that time; ego: x forward, y left, z up, on the ground amid the rear axle.
        ego_from_lidar: of the LiDAR (x right, y forward, z up).
        lidar: file of its points.
        lidar_tokens: of its sample_data, which name the files of nuScenes-lidarseg.
        ego_from_camera: of each camera at its own time, in the ego frame of the LiDAR's time.
        mounted: the same without the motion of the car between the two moments.
        intrinsics: 3x3 of each camera.
        images: file of each camera.
        size: width and height of the images, px.
    """

    tokens: np.ndarray
    time_us: np.ndarray
    world_from_ego: np.ndarray
    ego_from_lidar: np.ndarray
    lidar: np.ndarray
    lidar_tokens: np.ndarray
    ego_from_camera: np.ndarray
    mounted: np.ndarray
    intrinsics: np.ndarray
    images: np.ndarray
    size: np.ndarray


def records(path: Path, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Return the records of a table one by one: the largest tables have more than a GB.

    Args:
        path: file with a list of records.
        progress: advances by MiB read.

    Raises:
        DataError: naming the file that is missing, cut off, no list, or has a key twice in a record.
    """
    decoder, text, started, whole_mib = json.JSONDecoder(object_pairs_hook=object_of_pairs), "", False, 0
    try:
        with path.open("rb") as binary, TextIOWrapper(binary, "utf-8") as file:
            while chunk := file.read(CHUNK_BYTES):
                while progress is not None and whole_mib < binary.tell() // MIB:
                    progress.advance()
                    whole_mib += 1
                text, place = text + chunk, 0
                while True:
                    begin = _next(text, place, started)
                    if begin is None:
                        break
                    if not started:
                        started, place = True, begin
                        continue
                    if text[begin] == "]":
                        return
                    try:
                        record, place = decoder.raw_decode(text, begin)
                    except json.JSONDecodeError:
                        place = begin  # the record goes on in the next chunk
                        break
                    if not isinstance(record, dict) or None in record.values():
                        raise ValueError(f"a record holds no value, or null: {repr_of(record)}")
                    yield record
                text = text[place:]
    except FileNotFoundError as error:
        raise DataError(f"{path}: the table is missing; download the metadata of nuScenes") from error
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError is one
        raise DataError(f"{path}: the table is damaged: {first_line(error)}") from error
    raise DataError(f"{path}: the table is cut off or no list of records")


def once(path: Path, rows: Iterable[tuple[Key, Value]]) -> dict[Key, Value]:
    """Return what is taken from the records of a table, by what tells them apart.

    Raises:
        DataError: naming the table, and the key that stands twice or the value that a record lacks.
    """
    found: dict[Key, Value] = {}
    with _naming(path):
        for key, value in rows:
            if key in found:
                raise DataError(f"{path}: there are two records of {key}; keep one")
            found[key] = value
    return found


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the table whose records the block reads in the error about a value that is missing or wrong."""
    try:
        yield
    except FAULTS as error:
        raise DataError(f"{path}: a record lacks a value, or names one that is not there: {error}") from error


def _next(text: str, place: int, started: bool) -> int | None:
    """Return the place of the next record or of the list's end; before the list the place behind its '['."""
    while place < len(text) and text[place] in " \n\r\t,":
        place += 1
    if place == len(text):
        return None
    if not started:
        return place + 1 if text[place] == "[" else None
    return place


def read_key_frames(tables: Path, keep: Sequence[str] | None = None) -> dict[str, KeyFrames]:
    """Return the key frames of every scene by its name, from the tables of one version.

    Args:
        tables: folder such as `v1.0-trainval`.
        keep: names of scenes; None: all.

    Raises:
        DataError: naming the table and the record that is missing or wrong, or the name of a scene or token of a
            sample by which no file can be called.
    """
    names = ("sample", "calibrated_sensor", "sample_data", "ego_pose")
    files = [tables / f"{name}.json" for name in names]
    mib = sum(file.stat().st_size // MIB for file in files if file.exists())
    with Progress(f"index of {tables.name}", max(mib, 1), "MiB") as progress:
        path = tables / "scene.json"
        scenes = once(
            path,
            (
                (r["token"], checked_name("a scene", r["name"]))
                for r in records(path)
                if keep is None or r["name"] in keep
            ),
        )
        if not scenes:
            raise DataError(f"{path}: it has no record of a scene" + (" that is wanted" if keep is not None else ""))
        if (name := twice(scenes.values())) is not None:
            raise DataError(f"{path}: there are two records of scene '{name}'; keep one")
        path = tables / "sample.json"
        rows = (r for r in records(path, progress) if r["scene_token"] in scenes)
        named = ((checked_name(f"{path}: token", r["token"]), r) for r in rows)
        samples = once(path, ((token, (scenes[r["scene_token"]], int(r["timestamp"]))) for token, r in named))
        if not samples:
            raise DataError(f"{path}: it has no sample of the scenes of scene.json")
        path = tables / "sensor.json"
        channels = once(path, ((r["token"], r["channel"]) for r in records(path)))
        path = tables / "calibrated_sensor.json"
        calibrated = once(path, ((r["token"], r) for r in records(path, progress)))
        path, wanted = tables / "sample_data.json", {*CAMERAS, LIDAR}
        rows = (r for r in records(path, progress) if r["is_key_frame"] and r["sample_token"] in samples)
        of_sensors = ((channels[calibrated[r["calibrated_sensor_token"]]["sensor_token"]], r) for r in rows)
        taken = once(path, (((r["sample_token"], name), r) for name, r in of_sensors if name in wanted))
        with _naming(path):
            tokens = {r["ego_pose_token"] for r in taken.values()}
        path = tables / "ego_pose.json"
        poses = once(path, ((r["token"], r) for r in records(path, progress) if r["token"] in tokens))
    ordered: dict[str, list[str]] = {}
    for token, (scene, _) in sorted(samples.items(), key=lambda item: item[1][1]):
        ordered.setdefault(scene, []).append(token)
    with _naming(tables / "sample_data.json"):
        return {name: _scene(tables, name, found, taken, calibrated, poses) for name, found in sorted(ordered.items())}


def _scene(
    tables: Path, scene: str, tokens: list[str], taken: dict[tuple[str, str], Any], calibrated: Rows, poses: Rows
) -> KeyFrames:
    columns: dict[str, list[Any]] = {name: [] for name in KeyFrames._fields}
    for token in tokens:
        absent = [channel for channel in (*CAMERAS, LIDAR) if (token, channel) not in taken]
        if absent:
            raise DataError(
                f"{tables / 'sample_data.json'}: scene '{scene}', sample {token} has no {', '.join(absent)}"
            )
        lidar, cameras = taken[token, LIDAR], [taken[token, channel] for channel in CAMERAS]
        world_from_ego = _pose(tables, "ego_pose", poses, lidar["ego_pose_token"])
        mounted = [_pose(tables, "calibrated_sensor", calibrated, r["calibrated_sensor_token"]) for r in cameras]
        world_from_then = [_pose(tables, "ego_pose", poses, r["ego_pose_token"]) for r in cameras]
        row = {
            "tokens": token,
            "time_us": int(lidar["timestamp"]),
            "world_from_ego": world_from_ego,
            "ego_from_lidar": _pose(tables, "calibrated_sensor", calibrated, lidar["calibrated_sensor_token"]),
            "lidar": lidar["filename"],
            "lidar_tokens": lidar["token"],
            "ego_from_camera": inverse(world_from_ego) @ np.array(world_from_then) @ np.array(mounted),
            "mounted": mounted,
            "intrinsics": [_intrinsics(tables, calibrated, r["calibrated_sensor_token"]) for r in cameras],
            "images": [r["filename"] for r in cameras],
            "size": [(r["width"], r["height"]) for r in cameras],
        }
        for name, value in row.items():
            columns[name].append(value)
    return KeyFrames(**{name: np.array(values) for name, values in columns.items()})


def _intrinsics(tables: Path, calibrated: Rows, token: str) -> np.ndarray:
    with _naming(tables / "calibrated_sensor.json"):
        matrix = np.array(calibrated[token]["camera_intrinsic"], np.float64)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise ValueError(f"camera_intrinsic of {token} is no 3x3 matrix of numbers")
        return matrix


def _pose(tables: Path, table: str, rows: Rows, token: str) -> np.ndarray:
    if token not in rows:
        raise DataError(f"{tables / table}.json: the record {token} is missing")
    with _naming(tables / f"{table}.json"):
        rotation, translation_m = rows[token]["rotation"], rows[token]["translation"]
        try:
            return quaternion_pose(rotation, translation_m, f"record {token}")
        except FAULTS as error:
            raise DataError(f"{tables / table}.json: {error}") from error
