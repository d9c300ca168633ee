"""A log, and the choice of its samples that make the frames of a scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64, Int64, UInt8

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.data.formats.poses import inverse, shift
from omniocc.data.source import Points
from omniocc.errors import UserError
from omniocc.extras.recorders.streams import MISSING, gap_s, interpolate, lacking, nearest, paced
from omniocc.frame import Box

SHOWN = 5
"""Missing frames that are named in messages; all of them are listed in the scene's `meta.json`."""
POSES, LIDAR = "poses", "lidar"

ReadImage = Callable[[int, int], tuple[UInt8[np.ndarray, "height width 3"], str]]
"""Returns an image, RGB, by camera and number, and its name for messages."""


class Scan(NamedTuple):
    """What a LiDAR measured in one turn.

    Attributes:
        points: in the ego frame at the time of the scan, or, where they have times, each at its own.
        times_s: (P,) of the points; None where they are of one time.
    """

    points: Points
    times_s: Float64[np.ndarray, " P"] | None = None


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of a LiDAR.

    Attributes:
        times_s: (S,) increasing.
        read: returns a scan by its number.
        name: returns the file or message of a scan by its number, for messages.
        classes: of the points; free and occupied if they have none.
        position_m: (3,) of the LiDAR in the ego frame, where its rays start.
        boxes: returns the boxes of all actors at the time of a scan by its number, ego frame; None without them.
    """

    times_s: Float64[np.ndarray, " S"]
    read: Callable[[int], Scan]
    name: Callable[[int], str]
    classes: ClassTable
    position_m: Float64[np.ndarray, " 3"]
    boxes: Callable[[int], tuple[Box, ...]] | None = None


@dataclass(frozen=True, eq=False)
class Log:
    """What a car has recorded; all time stamps are of one clock and in s.

    Attributes:
        place: of the log, for messages.
        rig: the cameras, at the size of their calibration.
        image_times_s: for each camera the times of its images, increasing.
        read_image: see `ReadImage`.
        pose_times_s: (P,) increasing.
        world_from_ego: (P, 4, 4) at these times.
        scans: of the LiDAR; None without one.
        facts: plain values that say what it is made from.
        inputs: plain values that differ when other files or options would give other frames.
    """

    place: str
    rig: Rig
    image_times_s: tuple[Float64[np.ndarray, " S"], ...]
    read_image: ReadImage
    pose_times_s: Float64[np.ndarray, " P"]
    world_from_ego: Float64[np.ndarray, "P 4 4"]
    scans: Scans | None
    facts: Mapping[str, Any]
    inputs: Sequence[Any] = ()


def at_height(log: Log, above_m: float, road_z_m: float) -> Log:
    """Return the log in an ego frame whose origin is `above_m` above the road: rig, poses and points.

    Args:
        log: in the ego frame of its rig.
        above_m: above 0.
        road_z_m: height of the road in that frame, m.
    """
    height_m = road_z_m + above_m
    return replace(
        log,
        # exactly this height, since scenes of a folder have to agree
        rig=replace(replace(log.rig, road_z_m=None).raised(height_m), road_z_m=-above_m),
        world_from_ego=log.world_from_ego @ shift(0.0, 0.0, height_m),
        scans=None if log.scans is None else _lowered(log.scans, np.array([0, 0, height_m])),
    )


def _lowered(scans: Scans, lower_m: Float64[np.ndarray, " 3"]) -> Scans:
    """Return the scans in an ego frame whose origin is at `lower_m` of theirs."""

    def read(number: int) -> Scan:
        points, times_s = scans.read(number)
        return Scan(points._replace(points_m=points.points_m - lower_m.astype(np.float32)), times_s)

    def boxes(number: int) -> tuple[Box, ...]:
        assert scans.boxes is not None
        return moved_boxes(scans.boxes(number), shift(*-lower_m))

    boxed = None if scans.boxes is None else boxes
    return replace(scans, read=read, position_m=scans.position_m - lower_m, boxes=boxed)


def moved_boxes(boxes: Sequence[Box], a_from_b: Float64[np.ndarray, "4 4"]) -> tuple[Box, ...]:
    """Return boxes of frame b in frame a, upright there as well; their velocities stay those over the ground."""
    rotation = a_from_b[:3, :3]
    yaw_rad = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    return tuple(
        replace(
            box,
            center_m=tuple((rotation @ box.center_m + a_from_b[:3, 3]).tolist()),
            yaw_rad=float(np.angle(np.exp(1j * (box.yaw_rad + yaw_rad)))),  # in [-pi, pi]
            velocity_mps=tuple((rotation[:2, :2] @ box.velocity_mps).tolist()),
        )
        for box in boxes
    )


class Timing(NamedTuple):
    """Which samples make a frame.

    Attributes:
        reference: name of the camera whose images set the times of the frames; None: the first of the rig.
        limit_s: largest difference in time between a frame and its images, its scan and the ends of the poses.
        interval_s: time between frames; None: every image of the reference camera.
        pose_gap_s: longest time between two poses that are interpolated.
    """

    reference: str | None
    limit_s: float
    interval_s: float | None
    pose_gap_s: float


class Plan(NamedTuple):
    """The frames of a scene.

    Attributes:
        times_s: (F,) of the frames, by the clock of the log.
        images: (F, N) number of the image of each camera.
        scans: (F,) number of the scan; None without a LiDAR.
        world_from_ego: (F, 4, 4).
        ego_from_scan: (F, 4, 4) pose of the car when the scan was taken, in the frame's ego frame; None where every
            scan has the time of its frame.
        missing: time of each frame that is left out, and the streams that lack a sample.
    """

    times_s: Float64[np.ndarray, " F"]
    images: Int64[np.ndarray, "F N"]
    scans: Int64[np.ndarray, " F"] | None
    world_from_ego: Float64[np.ndarray, "F 4 4"]
    ego_from_scan: Float64[np.ndarray, "F 4 4"] | None
    missing: list[tuple[float, list[str]]]


def plan_frames(log: Log, timing: Timing) -> Plan:
    """Return the frames for which every camera, the poses and the LiDAR have a sample within the limit.

    Raises:
        UserError: naming the camera that does not exist, or what is missing in every frame.
    """
    names = log.rig.names
    reference = names[0] if timing.reference is None else timing.reference
    if reference not in names:
        raise UserError(f"{log.place}: reference={reference} is no camera; cameras: {', '.join(names)}")
    clock = log.image_times_s[names.index(reference)]
    at_s = clock[paced(clock, timing.interval_s)]
    matches = {name: nearest(s, at_s, timing.limit_s) for name, s in zip(names, log.image_times_s, strict=True)}
    if log.scans is not None:
        matches[LIDAR] = nearest(log.scans.times_s, at_s, timing.limit_s)
    poses, known = interpolate(log.pose_times_s, log.world_from_ego, at_s, timing.limit_s, timing.pose_gap_s)
    lacks = lacking(matches | {POSES: np.where(known, 0, MISSING)})
    kept = np.array([not names for names in lacks], bool)
    if not kept.any():
        raise UserError(_nothing(log, reference, at_s, lacks, timing.limit_s))
    images = np.stack([matches[name] for name in names], axis=1)[kept]
    missing = [(float(time_s), names) for time_s, names in zip(at_s, lacks, strict=True) if names]
    scans = matches[LIDAR][kept] if log.scans is not None else None
    from_scan = None if scans is None else _motion(log, timing, at_s[kept], scans, poses[kept])
    return Plan(at_s[kept], images, scans, poses[kept], from_scan, missing)


def _motion(
    log: Log,
    timing: Timing,
    at_s: Float64[np.ndarray, " F"],
    scans: Int64[np.ndarray, " F"],
    poses: Float64[np.ndarray, "F 4 4"],
) -> Float64[np.ndarray, "F 4 4"] | None:
    """Return the poses of the car at the times of scans in its frames at `at_s`; None where all times are the same.

    The frames have poses and the scans are near, so that gaps of the poses do not matter, nor their ends.
    """
    assert log.scans is not None
    scan_s = log.scans.times_s[scans]
    if np.array_equal(scan_s, at_s):
        return None
    there, _ = interpolate(log.pose_times_s, log.world_from_ego, scan_s, 2 * timing.limit_s)
    return inverse(poses) @ there


def _nothing(log: Log, reference: str, at_s: np.ndarray, lacks: list[list[str]], limit_s: float) -> str:
    """Return a line on why no frame is complete: the stream that is farthest from the reference camera."""
    streams = dict(zip(log.rig.names, log.image_times_s, strict=True)) | {POSES: log.pose_times_s}
    if log.scans is not None:
        streams[LIDAR] = log.scans.times_s
    gaps = {name: gap_s(times_s, at_s) for name, times_s in streams.items()}
    far = max(gaps, key=lambda name: gaps[name])
    often = {name: sum(name in names for names in lacks) for name in streams}
    counts = ", ".join(f"{name} in {count}" for name, count in often.items() if count)
    return (
        f"{log.place}: none of {len(at_s)} frames of '{reference}' is complete (missing: {counts}): '{far}' comes "
        f"no nearer than {gaps[far]:.6g} s, limit_s is {limit_s:g}. Are the units of its times right "
        f"(time_unit, poses_time_unit), and is it the same clock?"
    )


def missing_lines(plan: Plan) -> list[str]:
    """Return a line on the number of frames that are left out and one for each of the first."""
    if not plan.missing:
        return []
    total = len(plan.missing) + len(plan.times_s)
    lines = [f"{len(plan.missing)} of {total} frames are left out; meta.json lists them all"]
    lines += [f"  {time_s:.6f} s: nothing from {', '.join(names)}" for time_s, names in plan.missing[:SHOWN]]
    return lines + ["  ..."] * (len(plan.missing) > SHOWN)


def check_timing(timing: Timing) -> Timing:
    """Return the timing; raise ValueError naming what is impossible."""
    for name, value in (("limit_s", timing.limit_s), ("pose_gap_s", timing.pose_gap_s)):
        if not value > 0:
            raise ValueError(f"{name} is {value}; it must be above 0")
    if timing.interval_s is not None and not timing.interval_s > 0:
        raise ValueError(f"interval_s is {timing.interval_s}; it must be above 0, or null for every image")
    return timing


def chosen_rig(rig: Rig, names: Sequence[str]) -> Rig:
    """Return the named cameras of a rig, in this order.

    Raises:
        UserError: naming the one that the rig does not have.
    """
    if unknown := [name for name in names if name not in rig.names]:
        raise UserError(f"cameras: the rig has no camera '{unknown[0]}'; it has {', '.join(rig.names)}")
    if not names:
        raise UserError(f"cameras: name at least one of {', '.join(rig.names)}")
    places = [rig.names.index(name) for name in names]
    masks = None if rig.masks is None else tuple(rig.masks[place] for place in places)
    cameras = tuple(rig.cameras[place] for place in places)
    return Rig(cameras, rig.ego_from_camera[torch.tensor(places)], tuple(names), masks, rig.road_z_m)
