"""Read a dataset back, all of it or a part, and list everything that is wrong with it."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from omniocc.data.formats.poses import not_rigid
from omniocc.data.labels.class_fractions import spread
from omniocc.data.recording.pool import mapped
from omniocc.data.source import SPLITS, SceneFrames, SceneSource, VoxelLabels
from omniocc.data.store.codec import POINTS
from omniocc.data.store.reader import SceneReader
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.progress import Progress


def check_source(source: SceneSource, geometry: Grid, frames: int, workers: int) -> Iterator[str]:
    """Return the problems of a source that is prepared, one line each, as they are found.

    Args:
        source: the dataset.
        geometry: grid in which its labels are asked for.
        frames: of each scene, evenly spread, the first and the last included; 0: all.
        workers: processes that read; 0 reads in this one.
    """
    labels = source.labels(geometry, "free")
    scenes = [scene for split in SPLITS for scene in source.scenes(split)]
    work = partial(check_scene, labels=labels, frames=frames)
    total = sum(len(scene) if frames == 0 else min(frames, len(scene)) for scene in scenes)
    with Progress("check", total) as progress:
        for problems, count in mapped(work, scenes, workers):
            for _ in range(count):
                progress.advance()
            yield from problems


def has_labels(scene: SceneFrames) -> bool:
    """Return whether voxels of a scene can be known: not if it was recorded without a LiDAR."""
    return not isinstance(scene, SceneReader) or scene.has(POINTS)


def check_scene(scene: SceneFrames, labels: VoxelLabels, frames: int) -> tuple[list[str], int]:
    """Return the problems of a scene, each once, and the number of frames that were read."""
    problems, read = [], 0
    try:
        problems += _poses(scene)
        for frame in range(len(scene)) if frames == 0 else spread(len(scene), frames):
            problems += check_frame(scene, labels, frame)
            read += 1
    except (DataError, ValueError) as error:
        problems.append(str(error))
    return list(dict.fromkeys(problems)), read


def check_frame(scene: SceneFrames, labels: VoxelLabels, frame: int) -> Iterator[str]:
    """Return the problems of one frame: everything that a batch could ask for is read."""
    parts: list[Callable[[int], Any]] = [
        partial(_images, scene), scene.pixel_labels, scene.camera_range_m, scene.erp_range_m, scene.lidar, scene.points,
    ]  # fmt: skip
    if has_labels(scene):
        parts += [partial(labels.read, scene), partial(labels.benchmark, scene)]
    for part in parts:
        try:
            part(frame)
        except (DataError, ValueError) as error:
            yield str(error)


def _images(scene: SceneFrames, frame: int) -> None:
    """Read the images of one frame; raise ValueError if they are not those of its rig."""
    images, rig = scene.images(frame), scene.rigs[frame]
    sizes = [(camera.width, camera.height) for camera in rig.cameras]
    found = [(image.shape[1], image.shape[0]) for image in images]
    if found and found != sizes:
        raise ValueError(f"scene '{scene.name}', frame {frame}: images of {found} px, but the rig has {sizes} px")


def _poses(scene: SceneFrames) -> Iterator[str]:
    poses = np.asarray(scene.world_from_ego)
    if len(poses) != len(scene) or len(scene.rigs) != len(scene):
        yield f"scene '{scene.name}': {len(scene)} frames, {len(poses)} poses and {len(scene.rigs)} rigs"
    for frame in np.flatnonzero(not_rigid(poses) | ~np.isfinite(poses).all(axis=(1, 2))):
        yield f"scene '{scene.name}', frame {frame}: its pose is no rotation and shift"
