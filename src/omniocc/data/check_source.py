"""Read a dataset back, all of it or a part, and list everything that is wrong with it."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.classes import FREE, UNKNOWN
from omniocc.data.formats.poses import jumps, not_rigid
from omniocc.data.source import SPLITS, Points, SceneFrames, SceneSource, SourceSpec, VoxelLabels
from omniocc.data.spacing import evenly_spaced
from omniocc.data.store.codec import POINTS
from omniocc.data.store.reader import SceneReader
from omniocc.errors import FAULTS, DataError, reason_of
from omniocc.geometry import Grid
from omniocc.parallel import mapped
from omniocc.progress import Progress
from rayiou.labels import ids_beyond

MAX_SPEED_MPS, MAX_TURN_DEG_PER_S = 70.0, 360.0
"""Beyond these the poses of a recorded log are wrong, or in another unit."""
DIRECTIONS, STEP_M = 16, 1e-3
"""Number of directions and distance (m) from the ego origin at which the cells are looked up where rays begin."""
LEAST_NEAR = 1e-3
"""Fraction of the points of a scan, at least, that lies within the reach of the scores."""
FAR_M = 256.0
"""Median distance of points that no LiDAR on a car measures; points beyond are not even stored."""
CLUSTERED = 0.2
"""Spread of points in world coordinates about their middle as a fraction of their distance, at most."""
LABELS: dict[str, Callable[[Any], Iterable[np.ndarray | Tensor]]] = {
    "pixels": lambda found: found,
    "LiDAR": lambda found: [found.labels],
    "points": lambda found: [found.labels],
    "voxels": lambda found: [found],
    "benchmark": lambda found: [found.voxels],
}
"""The classes in each part of a frame."""


class Expected(NamedTuple):
    """What scenes are compared with.

    Attributes:
        spec: facts about all scenes.
        labels: voxels of the model's grid.
        geometry: this grid.
    """

    spec: SourceSpec
    labels: VoxelLabels
    geometry: Grid


def check_source(source: SceneSource, geometry: Grid, frames: int, workers: int) -> Iterator[str]:
    """Return the problems of a source that is prepared, one line each, as they are found.

    Args:
        source: the dataset.
        geometry: grid in which its labels are asked for.
        frames: of each scene, evenly spread, the first and the last included; 0: all.
        workers: processes that read; 0 reads in this one.
    """
    scenes = [scene for split in SPLITS for scene in source.scenes(split)]
    work = partial(
        check_scene, expected=Expected(source.spec, source.labels(geometry, "none"), geometry), frames=frames
    )
    total = sum(count if frames == 0 else min(frames, count) for count in map(frames_of, scenes))
    with Progress("check", total) as progress:
        for problems, count in mapped(work, scenes, workers):
            for _ in range(count):
                progress.advance()
            yield from problems


def frames_of(scene: SceneFrames) -> int:
    """Return the number of frames; 0 if the scene cannot even tell that, which `check_scene` reports."""
    try:
        return len(scene)
    except (DataError, *FAULTS):
        return 0


def has_labels(scene: SceneFrames) -> bool:
    """Return whether voxels of a scene can be known: not if it was recorded without a LiDAR."""
    return not isinstance(scene, SceneReader) or scene.has(POINTS)


def check_scene(scene: SceneFrames, expected: Expected, frames: int) -> tuple[list[str], int]:
    """Return the problems of a scene, each once, and the number of frames that were read."""
    problems, voxels, read = [], [], 0
    try:
        problems += _poses(scene)
        rigs = scene.rigs[:1]
        problems += [f"scene '{scene.name}', {line}" for rig in rigs for line in lenses_that_do_not_fit(rig)]
        for frame in range(len(scene)) if frames == 0 else evenly_spaced(len(scene), frames):
            found, labels = check_frame(scene, expected, frame)
            problems += found
            voxels += [] if labels is None else [start_of_rays(labels, expected.geometry)]
            read += 1
    except (DataError, *FAULTS) as error:
        problems.append(_line(f"scene '{scene.name}'", error))
    return list(dict.fromkeys([*problems, *_grid(scene, expected.spec, voxels)])), read


def check_frame(scene: SceneFrames, expected: Expected, frame: int) -> tuple[list[str], Tensor | None]:
    """Return the problems of one frame, and its voxels: everything that a batch could ask for is read."""
    parts: dict[str, Callable[[int], Any]] = {
        "images": partial(_images, scene),
        "pixels": scene.pixel_labels,
        "camera ranges": scene.camera_range_m,
        "panorama": scene.erp_range_m,
        "LiDAR": scene.lidar,
        "points": scene.points,
    }
    if has_labels(scene):
        parts |= {
            "voxels": partial(expected.labels.read, scene),
            "benchmark": partial(expected.labels.benchmark, scene),
        }
    problems, found = [], {}
    where = f"scene '{scene.name}', frame {frame}"
    for name, part in parts.items():
        try:
            found[name] = part(frame)
        except (DataError, *FAULTS) as error:
            problems.append(_line(f"{where}: {name}", error))
    for name, arrays_of in LABELS.items():
        if found.get(name) is not None:
            lines = _classes(arrays_of(found[name]), expected.spec.classes.num_classes)
            problems += [f"{where}: {name}: {line}" for line in lines]
    if found.get("points") is not None:
        problems += [f"{where}: {line}" for line in _points(found["points"], expected.spec.reach_m)]
    return problems, found.get("voxels")


def _line(where: str, error: Exception) -> str:
    """Return a line about an error: those of readers name scene and frame, others do not."""
    return str(error) if isinstance(error, DataError | ValueError) else f"{where}: {reason_of(error)}"


def start_of_rays(voxels: Tensor, geometry: Grid) -> int | None:
    """Return the class of the occupied cells in which most rays from the ego origin begin.

    It is 0 (free) if they begin in free or unknown cells or outside of the grid, and None if no cell is occupied.
    """
    if not ((voxels != FREE) & (voxels != UNKNOWN)).any():
        return None
    angles = torch.arange(DIRECTIONS, dtype=torch.float64) * (2 * math.pi / DIRECTIONS)
    around_m = STEP_M * torch.stack([angles.cos(), angles.sin(), torch.zeros_like(angles)], dim=-1)
    cells, inside = geometry.flat_index(around_m)
    ((label, count),) = Counter(map(int, voxels.flatten()[cells[inside]].tolist())).most_common(1) or [(FREE, 0)]
    return label if 2 * count > DIRECTIONS and label != UNKNOWN else FREE


def _images(scene: SceneFrames, frame: int) -> None:
    """Read the images of one frame; raise ValueError if they are not those of its rig."""
    images, rig = scene.images(frame), scene.rigs[frame]
    sizes = [(camera.width, camera.height) for camera in rig.cameras]
    found = [(image.shape[1], image.shape[0]) for image in images]
    if found and found != sizes:
        raise ValueError(f"scene '{scene.name}', frame {frame}: images of {found} px, but the rig has {sizes} px")


def _classes(labels: Iterable[np.ndarray | Tensor], num_classes: int) -> Iterator[str]:
    arrays = [np.asarray(part) for part in labels]
    if types := sorted({str(array.dtype) for array in arrays} - {"uint8"}):
        yield f"classes are {', '.join(types)} instead of uint8"
    if wrong := sorted({number for array in arrays for number in ids_beyond(array, num_classes)}):
        yield f"classes {wrong} do not exist; the source has 0 to {num_classes - 1}, and 255 for unknown"


def _points(points: Points, reach_m: float) -> Iterator[str]:
    if lost := int((~np.isfinite(points.points_m)).any(axis=1).sum()):
        yield f"{lost} of its {len(points.points_m)} points are not finite; leave out rays that did not come back"
    yield from filter(None, [out_of_reach(points.points_m, reach_m)])


def _grid(scene: SceneFrames, spec: SourceSpec, starts: Sequence[int | None]) -> Iterator[str]:
    if starts and all(label is None for label in starts):
        yield (
            f"scene '{scene.name}': no cell of the model's grid is occupied in {len(starts)} frames; its cells are too "
            "large for these labels, or the labels lie elsewhere"
        )
    inside = [label for label in starts if label]
    if spec.benchmark is None and len(inside) * 2 > len(starts):
        names = ", ".join(sorted({spec.classes.names[label] for label in inside if label < spec.classes.num_classes}))
        yield (
            f"scene '{scene.name}': the ego origin lies in an occupied cell ({names}) in {len(inside)} of "
            f"{len(starts)} frames, so that all rays of RayIoU end at once and every model scores the same; put the "
            "origin higher above the road, or choose smaller cells"
        )


def _poses(scene: SceneFrames) -> Iterator[str]:
    poses = np.asarray(scene.world_from_ego)
    if len(poses) != len(scene) or len(scene.rigs) != len(scene):
        yield f"scene '{scene.name}': {len(scene)} frames, {len(poses)} poses and {len(scene.rigs)} rigs"
    wrong = np.flatnonzero(not_rigid(poses) | ~np.isfinite(poses).all(axis=(1, 2)))
    for frame in wrong:
        yield f"scene '{scene.name}', frame {frame}: its pose is no rotation and shift"
    if isinstance(scene, SceneReader) and not len(wrong):
        for frame, problem in jumps(poses, scene.time_s, MAX_SPEED_MPS, MAX_TURN_DEG_PER_S):
            yield f"scene '{scene.name}', frame {frame}: {problem}"


def distances_m(points_m: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " F"]:
    """Return the horizontal distance of the points that are finite from the origin of their frame, m."""
    return np.linalg.norm(points_m[np.isfinite(points_m).all(axis=1), :2].astype(np.float64), axis=1)


def out_of_reach(points_m: Float[np.ndarray, "P 3"], reach_m: float) -> str:
    """Return a line if hardly any point of a scan, ego frame, lies within a horizontal distance, and why; else ''.

    World coordinates lie close together and far away; in another unit points still lie around the car.
    """
    distance_m = distances_m(points_m)
    near, total = int((distance_m < reach_m).sum()), len(distance_m)
    if near and near >= LEAST_NEAR * total:
        return ""
    found = f"{near:,} of its {total:,} points lie" if near else f"none of its {total:,} points lies"
    median_m = float(np.median(distance_m)) if total else np.nan
    if not total:
        likely = "rays that did not come back and points on the own car are left out"
    elif median_m < FAR_M:
        likely = f"their median distance is {median_m:,.0f} m; are the unit (m) and the pose of the LiDAR right?"
    else:
        middle_m = np.nanmedian(points_m.astype(np.float64), axis=0)
        spread_m = np.median(distances_m(points_m - middle_m))
        world = "world coordinates (UTM, map): give them in the frame of the LiDAR"
        looks = world if spread_m < median_m * CLUSTERED else "millimetres or another unit: give them in metres"
        likely = f"their median distance is {median_m:,.0f} m, which looks like {looks}"
    return f"{found} within {reach_m:g} m: {likely}"
