"""Compare a server's answers with one another: is what we assume of CARLA's frames, units and tags true there?"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8

from omniocc.data.formats.poses import inverse, transform_points
from omniocc.extras.carla_tags import ROAD, ROADLINE
from omniocc.extras.recorders import Finding
from omniocc.extras.recorders.carla.frames import ACTOR_CLASSES, RawFrame, actor_of, scans_of
from omniocc.extras.recorders.carla.sensors import Cube, Spec, inverse_depth_of, read_bgra, tags_in
from omniocc.extras.unreal import SENSOR_FROM_OPTICAL, UnrealPose, pose_of, right_handed

POSE_M, POSE_RAD = 0.02, np.radians(0.2)
"""Largest distance and angle of a sensor from where it was mounted."""
DEPTH_FRACTION = 0.02
"""Largest difference from 1 of the median ratio of both distances."""
SAME_TAGS = 0.85
"""Smallest fraction of points whose classes are equal, or right."""
IN_BOX = 0.9
"""Smallest fraction of an actor's points in its box, which is 0.2 m wider on each side."""
TIME_S = 1e-4
"""Largest difference of a step from the interval."""
UNDER_M = 5.0
"""Radius around the car in which the ground has to be road."""


def check_frames(
    frames: Sequence[RawFrame],
    sensors: Sequence[Spec],
    cube: Cube,
    interval_s: float,
    classes: UInt8[np.ndarray, " 256"],
) -> list[Finding]:
    """Return what a few frames say about the assumptions; `cube` is that around the ego origin."""
    last = frames[-1]
    depth, same = lidar_against_cameras(last, cube, classes)
    times, poses = check_times(frames, interval_s), check_poses(last, sensors)
    return [times, poses, depth, same, check_tags(last, classes), check_boxes(last, classes)]


def check_times(frames: Sequence[RawFrame], interval_s: float) -> Finding:
    """Return whether frames follow one another at the interval."""
    steps_s, numbers = np.diff([frame.time_s for frame in frames]), np.diff([frame.number for frame in frames])
    holds = bool((np.abs(steps_s - interval_s) < TIME_S).all() and (numbers == 1).all())
    return Finding(
        "time stamps: one tick is one interval", holds, f"steps of {steps_s.min():.4f} to {steps_s.max():.4f} s"
    )


def check_poses(frame: RawFrame, sensors: Sequence[Spec]) -> Finding:
    """Return whether the server puts sensors where our left- to right-handed conversion of their mounting says."""
    world_from_vehicle = right_handed(np.array(frame.world_from_vehicle))
    off_m, off_rad = [0.0], [0.0]
    for spec in sensors:
        expected = world_from_vehicle @ pose_of(UnrealPose(*spec["pose"]))
        found = right_handed(np.array(frame.matrices[spec["name"]]))
        off_m.append(float(np.linalg.norm(expected[:3, 3] - found[:3, 3])))
        cosine = (np.trace(expected[:3, :3].T @ found[:3, :3]) - 1) / 2
        off_rad.append(float(np.arccos(np.clip(cosine, -1, 1))))
    holds = max(off_m) < POSE_M and max(off_rad) < POSE_RAD
    return Finding(
        "handedness: sensors stand where they were mounted",
        holds,
        f"off by at most {100 * max(off_m):.1f} cm and {np.degrees(max(off_rad)):.2f} degrees",
    )


def lidar_against_cameras(frame: RawFrame, cube: Cube, classes: UInt8[np.ndarray, " 256"]) -> tuple[Finding, Finding]:
    """Return whether depth images measure the distances of LiDAR points, and whether both give them equal classes."""
    ratios, same = [np.empty(0)], [np.empty(0, bool)]
    world_from_lidar, scan = next(scans_of(frame, classes))
    for face in cube.lookup.faces:
        name = cube.face_name(face, "depth")
        side, inner = cube.lookup.side, cube.lookup.inner
        optical = right_handed(np.array(frame.matrices[name])) @ SENSOR_FROM_OPTICAL
        points = transform_points(inverse(optical) @ world_from_lidar, scan.points_m)
        ahead = points[:, 2] > 0.5
        pixels = np.rint(points[ahead, :2] / points[ahead, 2:] * inner / 2 + (side - 1) / 2).astype(int)
        inside = ((pixels >= 0) & (pixels < side)).all(axis=1)
        column, row = pixels[inside].T
        nearness = inverse_depth_of(read_bgra(frame.raw[name], side, side))[row, column]
        seen = classes[tags_in(read_bgra(frame.raw[cube.face_name(face, "semantics")], side, side))[row, column]]
        ratio = nearness * points[ahead, 2][inside]
        visible = np.abs(ratio - 1) < 0.1  # others are hidden from this camera by something
        ratios.append(ratio[(ratio > 0.3) & (ratio < 3)])
        given, seen = (np.where(part == ROADLINE, ROAD, part) for part in (scan.labels[ahead][inside], seen))
        same.append((given == seen)[visible])
    scale, equal = np.concatenate(ratios), np.concatenate(same)
    middle = float(np.median(scale)) if len(scale) else np.nan
    fraction = float(equal.mean()) if len(equal) else np.nan
    return (
        Finding(
            "depth: images and LiDAR agree on distances",
            abs(middle - 1) < DEPTH_FRACTION,
            f"median ratio {middle:.3f} over {len(scale)} points",
        ),
        Finding(
            "images: they agree with LiDAR on classes", fraction > SAME_TAGS, f"{fraction:.1%} of {len(equal)} points"
        ),
    )


def check_tags(frame: RawFrame, classes: UInt8[np.ndarray, " 256"]) -> Finding:
    """Return whether vehicles, walkers and the road under the car have the classes that our table of tags gives."""
    scans, right, count = [scan for _, scan in scans_of(frame, classes)], 0, 0
    for scan in scans:
        for actor in frame.actors:
            own = scan.labels[scan.actors == actor["id"]]
            right, count = right + int((own == ACTOR_CLASSES[actor["kind"]]).sum()), count + len(own)
    x, y, z = scans[0].points_m.T
    ground = scans[0].labels[(np.hypot(x, y) < UNDER_M) & (z < -1)]
    road = float(np.isin(ground, (ROAD, ROADLINE)).mean()) if len(ground) else np.nan
    fraction = right / count if count else np.nan
    measured = f"{fraction:.1%} of {count} points of actors, {road:.1%} of {len(ground)} points under the car are road"
    return Finding("tags: actors and the road have their classes", fraction > SAME_TAGS and road > 0.5, measured)


def check_boxes(frame: RawFrame, classes: UInt8[np.ndarray, " 256"]) -> Finding:
    """Return whether LiDAR points of vehicles and walkers lie in their boxes."""
    inside, count = 0, 0
    for world_from_lidar, scan in scans_of(frame, classes):
        for sent in frame.actors:
            actor = actor_of(sent)
            points = transform_points(
                inverse(actor.world_from_actor) @ world_from_lidar, scan.points_m[scan.actors == actor.id]
            )
            half = np.array(actor.size_m) / 2
            inside += int((np.abs(points - (0, 0, half[2])) < half + 0.2).all(axis=1).sum())
            count += len(points)
    fraction = inside / count if count else np.nan
    measured = f"{fraction:.1%} of {count} points" if count else "no vehicle was hit; try another town or more frames"
    return Finding("boxes: points of an actor lie in its box", bool(count) and fraction > IN_BOX, measured)
