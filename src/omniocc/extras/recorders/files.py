"""Logs as folders of files: images of each camera, poses, and perhaps scans of a LiDAR, all with time stamps."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from glob import glob
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8

from omniocc.bounds import Real, fits
from omniocc.camera import Rig
from omniocc.data.formats.clouds import LABEL_SUFFIX, READERS, RawCloud, read_cloud
from omniocc.data.formats.dataset_scene import outside
from omniocc.data.formats.files import IMAGE_SUFFIXES, rgb_of_camera
from omniocc.data.formats.pose_table import TimeUnit, read_table
from omniocc.data.formats.poses import inverse, transform_points
from omniocc.data.source import Points
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders.labels import PointClasses, classes_of, read_point_classes
from omniocc.extras.recorders.log import Log, Scan, Scans, Timing, chosen_rig
from omniocc.extras.recorders.log_scene import LogRecorder, SceneOptions
from omniocc.extras.recorders.poses import PER_SECOND, PosesFormat, read_timed_poses, seconds, stated_pose
from omniocc.extras.recorders.turns import OPEN_S, are_after, seconds_of
from omniocc.images import Depth, content_of

Corner = tuple[Real, Real, Real]
LIDAR_KEYS = {
    "folder": ...,
    "ego_from_lidar": ...,
    "classes": None,
    "label_field": None,
    "own_car_m": None,
    "columns": 4,
    "deskew": True,
}
"""Options of the LiDAR and their defaults; `...` is needed."""


class Stamped(NamedTuple):
    """Files in the order of time.

    Attributes:
        times_s: (S,) increasing.
        paths: of the files.
    """

    times_s: Float64[np.ndarray, " S"]
    paths: tuple[Path, ...]


class LogFiles(LogRecorder):
    """A recorder of a log that lies in folders; options are described in `conf/recorder/files.yaml`.

    Args:
        name: of the scene, and of its folder.
        log: folder of the log; all other paths may be relative to it.
        rig: calibration in any format that `Rig.load` reads, or a built-in rig.
        cameras: folder or glob of the images of each camera by its name in the rig; None: folders of these names.
        time_unit: of the numbers in file names or in `times`.
        times: CSV of time, file (as its path in the log, or its name); None: the last number in a file's name.
        poses: file of poses.
        poses_format: `csv`, `tum` or `kitti`, see `omniocc.extras.recorders.poses.read_timed_poses`.
        poses_times: file with a time in each line, for `kitti`.
        poses_time_unit: of the poses; None: `time_unit` for `csv`, s for the others.
        ego_from_pose_frame: pose, in the ego frame, of the frame whose poses the file holds; None: the ego frame.
        lidar: None, or a mapping with the keys of `LIDAR_KEYS`.
        reference: see `Timing`, as `limit_s`, `interval_s` and `pose_gap_s`.
        image_size: see `SceneOptions`, as `panorama`, `road_z_m` and `moving`.
        image_bits: how many of the bits of images of 16 are used; None: not known.
        origin_above_road_m: see `LogRecorder`.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(
        self,
        name: str,
        log: str,
        rig: str,
        cameras: Mapping[str, str] | None,
        time_unit: TimeUnit,
        times: str | None,
        poses: str,
        poses_format: PosesFormat,
        poses_times: str | None,
        poses_time_unit: TimeUnit | None,
        ego_from_pose_frame: Any,
        lidar: Mapping[str, Any] | None,
        reference: str | None,
        limit_s: float,
        interval_s: float | None,
        pose_gap_s: float,
        image_size: tuple[int, int] | None,
        panorama: tuple[int, int, float, float],
        road_z_m: float | None,
        moving: bool | None,
        image_bits: int | None = None,
        origin_above_road_m: float | None = None,
    ):
        super().__init__(
            name,
            Timing(reference, limit_s, interval_s, pose_gap_s),
            SceneOptions(image_size, panorama, road_z_m, moving),
            origin_above_road_m,
        )
        self.folder, self.depth = Path(log), Depth(image_bits, "recorder.image_bits")
        if time_unit not in PER_SECOND or poses_time_unit not in (None, *PER_SECOND):
            raise ValueError(f"time units are {', '.join(PER_SECOND)}, got {time_unit} and {poses_time_unit}")
        self.rig_file, self.cameras, self.times = rig, cameras, times
        self.time_unit: TimeUnit = time_unit
        self.poses, self.poses_times = poses, poses_times
        self.poses_format: PosesFormat = poses_format
        self.poses_unit: TimeUnit = poses_time_unit or (time_unit if poses_format == "csv" else "s")
        given = ego_from_pose_frame
        self.ego_from_pose_frame = np.eye(4) if given is None else stated_pose("ego_from_pose_frame", given)
        self.lidar = None if lidar is None else lidar_options(lidar, LIDAR_KEYS)

    @contextmanager
    def open(self) -> Iterator[Log]:
        """Give the log; images and scans are opened when they are asked for.

        Raises:
            UserError, DataError: naming the option or file that cannot be used.
        """
        if not self.folder.is_dir():
            raise UserError(f"log={self.folder}: there is no such folder")
        rig = self._rig()
        table = None if self.times is None else read_times(self.folder / self.times, self.time_unit)
        folders = {name: name for name in rig.names} if self.cameras is None else self.cameras
        images = [self._stamped(f"cameras.{name}", folders[name], IMAGE_SUFFIXES, table) for name in rig.names]
        times = None if self.poses_times is None else self.folder / self.poses_times
        poses = read_timed_poses(self.folder / self.poses, self.poses_format, self.poses_unit, times)

        def read_image(camera: int, number: int) -> tuple[UInt8[np.ndarray, "height width 3"], str]:
            path = images[camera].paths[number]
            return rgb_of_camera(content_of(path), str(path), rig.cameras[camera], self.depth), str(path)

        scans, given = (None, []) if self.lidar is None else self._scans(self.lidar, table)
        given = [*given, *stated_depth(self.depth)]
        yield Log(
            place=str(self.folder),
            rig=rig,
            image_times_s=tuple(stream.times_s for stream in images),
            read_image=read_image,
            pose_times_s=poses.times_s,
            world_from_ego=poses.poses @ inverse(self.ego_from_pose_frame),
            scans=scans,
            facts={"recorder": "files", "poses": self.poses, "limit_s": self.timing.limit_s},
            inputs=[str(self.folder.absolute()), *(listing(stream, self.folder) for stream in images), *given],
        )

    def _rig(self) -> Rig:
        beside = self.folder / self.rig_file
        try:
            rig = Rig.load(beside if beside.exists() else self.rig_file)
        except ValueError as error:
            raise UserError(f"rig: {error}") from error
        return rig if self.cameras is None else chosen_rig(rig, list(self.cameras))

    def _stamped(self, option: str, place: str, suffixes: Sequence[str], table: Mapping[str, float] | None) -> Stamped:
        return stamped_files(self.folder, place, suffixes, self.time_unit, table, option)

    def _scans(self, options: Mapping[str, Any], table: Mapping[str, float] | None) -> tuple[Scans, list[Any]]:
        """Return the scans, and plain values that differ when other files or options would give other points."""
        files = self._stamped("lidar.folder", options["folder"], tuple(READERS), table)
        classes = read_point_classes(None if options["classes"] is None else self.folder / options["classes"])

        def cloud_of_file(number: int) -> RawCloud:
            return read_cloud(files.paths[number], options["label_field"], options["columns"])

        def name(number: int) -> str:
            return str(files.paths[number])

        scans = scans_of(files.times_s, cloud_of_file, name, options["ego_from_lidar"], classes, options)
        return scans, [*plain_options(options, classes), listing(files, self.folder)]


def lidar_options(given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a LiDAR with defaults filled in; raise ValueError for unknown, missing and wrong ones."""
    if unknown := set(given) - set(known):
        raise ValueError(f"lidar has no option {', '.join(sorted(unknown))}; its options are {', '.join(known)}")
    if missing := [key for key, value in known.items() if value is ... and given.get(key) is None]:
        raise ValueError(f"lidar.{missing[0]} is missing")
    options = {**known, **given}
    if options["ego_from_lidar"] is not None:
        options["ego_from_lidar"] = stated_pose("lidar.ego_from_lidar", options["ego_from_lidar"])
    box = options["own_car_m"]
    if box is not None and not is_box(box):
        raise ValueError(f"lidar.own_car_m is {box}; give the lowest and the highest x, y, z: [[x, y, z], [x, y, z]]")
    if not isinstance(options["deskew"], bool):
        raise ValueError(f"lidar.deskew is {options['deskew']}; give true or false")
    if "columns" in options and (not isinstance(options["columns"], int) or options["columns"] < 3):
        raise ValueError(f"lidar.columns is {options['columns']}; a point has at least 3 numbers")
    return options


def is_box(value: Any) -> bool:
    """Return whether a value is the lowest and the highest corner of a box, three finite numbers each."""
    return fits(value, tuple[Corner, Corner]) and all(low < high for low, high in zip(*value, strict=True))


def scans_of(
    times_s: Float64[np.ndarray, " S"],
    cloud_of: Callable[[int], RawCloud],
    name: Callable[[int], str],
    ego_from_lidar: Float64[np.ndarray, "4 4"],
    classes: PointClasses,
    options: Mapping[str, Any],
) -> Scans:
    """Return the scans of a log: points in the ego frame with classes and times, without those in the own car's box.

    Args:
        times_s: (S,) of the scans, increasing.
        cloud_of: reads the points of a scan as they are.
        name: file or message of a scan.
        ego_from_lidar: pose of the LiDAR.
        classes: of the points.
        options: with the keys `own_car_m` and `deskew`.
    """

    @cache
    def after() -> bool | None:
        return are_after(cloud_of(-1).times, times_s[-1])

    def read(number: int) -> Scan:
        cloud, scan_s, where = cloud_of(number), times_s[number], name(number)
        labels = classes_of(cloud.labels, len(cloud.points_m), classes, where)
        points_m = transform_points(ego_from_lidar, cloud.points_m).astype(np.float32)
        box_m = options["own_car_m"]
        kept = np.ones(len(points_m), bool) if box_m is None else outside(points_m, *box_m)
        point_times_s = None
        if options["deskew"] and cloud.times is not None:
            # near 0 this scan cannot tell whether its times are after its stamp: the last scan of the log can
            point_times_s = seconds_of(cloud.times[kept], scan_s, where, after() if abs(scan_s) <= OPEN_S else None)
        return Scan(Points(points_m[kept], labels[kept]), point_times_s)

    return Scans(times_s, read, name, classes.table, ego_from_lidar[:3, 3])


def plain_options(options: Mapping[str, Any], classes: PointClasses) -> list[Any]:
    """Return the options of a LiDAR and the classes of its points as plain values."""
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in options.items()}
    return [sorted(plain.items()), repr(classes.of_id)]


def listing(files: Stamped, folder: Path) -> list[tuple[str, int]]:
    """Return the path in the log and the size of every file."""
    return [(path_in(folder, path), path.stat().st_size) for path in files.paths]


def path_in(folder: Path, path: Path) -> str:
    """Return the path of a file in a log; of one elsewhere, its own path."""
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


def read_times(path: Path, unit: TimeUnit) -> dict[str, float]:
    """Return the time, s, of every file that a table of time, file lists; a header may name them in any order.

    Raises:
        DataError: naming the line that is wrong, or the file that stands twice.
    """
    found: dict[str, float] = {}
    for row in read_table(path, ("time", "file")):
        stamp, name = row.keys
        if name in found:
            raise DataError(f"{row.where}: the file '{name}' has a time already; keep one")
        try:
            found[name] = seconds(stamp, row.unit or unit)
        except ValueError as error:
            raise DataError(f"{row.where}: {error}") from error
    return found


def stamped_files(
    folder: Path, place: str, suffixes: Sequence[str], unit: TimeUnit, table: Mapping[str, float] | None, option: str
) -> Stamped:
    """Return the files of a folder or glob in the order of time.

    Args:
        folder: of the log.
        place: folder or glob, relative to it or absolute.
        suffixes: of the files that count.
        unit: of numbers in names.
        table: times by path in the log or by name; None: the last number in the name.
        option: that names the place, for messages.

    Raises:
        UserError: if there are no files.
        DataError: naming the file without a time stamp, or with that of another.
    """
    is_glob = any(mark in place for mark in "*?[")
    if not is_glob and not (folder / place).is_dir():
        raise UserError(f"{option}={place}: there is no folder {folder / place}")
    entries = map(Path, glob(str(folder / place))) if is_glob else (folder / place).iterdir()
    paths = sorted(path for path in entries if path.suffix.lower() in suffixes and path.suffix != LABEL_SUFFIX)
    if not paths:
        raise UserError(f"{option}={place}: {folder / place} holds none of {', '.join(suffixes)}")
    times_s = np.array([_time_of(path, folder, unit, table) for path in paths])
    order = np.argsort(times_s, kind="stable")
    if (same := np.flatnonzero(np.diff(times_s[order]) == 0)).size:
        first, second = (paths[order[same[0] + step]] for step in (0, 1))
        raise DataError(f"{second}: it has the same time stamp as {first.name}")
    return Stamped(times_s[order], tuple(paths[place] for place in order))


def _time_of(path: Path, folder: Path, unit: TimeUnit, table: Mapping[str, float] | None) -> float:
    if table is not None:
        for key in (path_in(folder, path), path.name):
            if key in table:
                return table[key]
        raise DataError(f"{path}: the CSV of times does not list it")
    numbers = re.findall(r"[0-9]+(?:\.[0-9]+)?", path.stem)
    if not numbers:
        raise DataError(f"{path}: its name has no number that could be its time; give times=<CSV of time,file>")
    return seconds(numbers[-1], unit)


def stated_depth(depth: Depth) -> list[Any]:
    """Return plain values that differ when images of 16 bits are read otherwise; none where nothing is stated."""
    return [] if depth.bits is None else [f"{depth.key}={depth.bits}"]
