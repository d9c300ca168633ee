"""Which frames are shown, and what is known of them: the test scenes of a run's data, or recorded scenes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from omniocc.batch import Batch
from omniocc.camera import Equirectangular, Rig
from omniocc.data import OccupancyData
from omniocc.data.check_source import has_labels
from omniocc.data.dataset import Needs, WindowDataset, collate
from omniocc.data.labels.voxels import cell_evidence
from omniocc.data.source import Ignore, MadeScenes, SceneFrames, SourceSpec, VoxelLabels
from omniocc.data.source.recorded import spec_of, votes_of
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import digest
from omniocc.errors import UserError
from omniocc.extras.viewer.frames import FramePrediction, ShownFrame
from omniocc.geometry import Grid
from omniocc.predict.input.sequence import check_scene, chosen_frames, find_scenes, frame_name

LABELS_ONLY = Needs(images=False, pixel_labels=False)


@dataclass(frozen=True, eq=False)
class ChosenScenes:
    """Scenes with the frames of each that are shown.

    Attributes:
        spec: classes, bands and LiDAR rays.
        scenes: each with the indices of its frames.
        labels: returns the voxel labels of a grid.
        panorama: directions of true panoramas where a scene does not state its own; None: not known.
        source: where the scenes come from, in words.
        fingerprint: equal for equal data.
    """

    spec: SourceSpec
    scenes: Sequence[tuple[SceneFrames, Sequence[int]]]
    labels: Callable[[Grid], VoxelLabels]
    panorama: Equirectangular | None
    source: str
    fingerprint: str

    def truth(self, scene: SceneFrames, frame: int, grid: Grid) -> Batch | None:
        """Return the voxels of a frame on a grid, and all else that scores need; None where nothing is known."""
        if not has_labels(scene):
            return None
        own_rays = self.spec.lidar_directions is None
        return collate([WindowDataset([scene], self.labels(grid), 1, LABELS_ONLY, own_rays)[frame]])

    def true_panorama(self, scene: SceneFrames, shape: tuple[int, ...]) -> Equirectangular | None:
        """Return the directions of a scene's true panorama of this shape; None if they are not known."""
        stated = getattr(scene, "panorama", None)
        if stated is None and isinstance(scene, SceneReader) and "panorama_edges_deg" in scene.meta["facts"]:
            stated = Equirectangular(shape[1], shape[0], *scene.meta["facts"]["panorama_edges_deg"])
        stated = stated or self.panorama
        return stated and stated.resized(shape[1], shape[0])


def time_of(scene: SceneFrames, frame: int, interval_s: float) -> float:
    """Return the time of a frame since its scene began, s."""
    return float(scene.time_s[frame]) if isinstance(scene, SceneReader) else frame * interval_s


def test_scenes(
    data: OccupancyData,
    scene: str | None,
    frames: Sequence[int] | None,
    limit: int | None,
    panorama: Equirectangular | None,
) -> ChosenScenes:
    """Return the chosen frames of the test scenes of a run's data.

    Of the virtual world the chosen scenes are rendered if they are missing. Arguments as in `choose`; `panorama` as in
    `ChosenScenes`.

    Raises:
        UserError: naming what does not exist.
        DataError: when scenes are missing or damaged.
    """
    source = data.source
    if isinstance(source, MadeScenes):
        chosen = choose(source.planned("test"), scene, frames, limit, source.folder.name)
        found = {one.name: one for one in source.made("test", list(chosen))}
    else:
        source.prepare()
        found = {one.name: one for one in source.scenes("test")}
        chosen = choose({name: len(one) for name, one in found.items()}, scene, frames, limit, str(source.folder))

    def labels(grid: Grid) -> VoxelLabels:
        return source.labels(grid, data.ignore)

    pairs = [(found[name], wanted) for name, wanted in chosen.items()]
    return ChosenScenes(data.spec, pairs, labels, panorama, f"test scenes of {source.folder}", source.fingerprint)


def recorded_scenes(
    folder: str,
    scene: str | None,
    frames: Sequence[int] | None,
    limit: int | None,
    ignore: Ignore,
    panorama: Equirectangular | None,
) -> ChosenScenes:
    """Return the chosen frames of recorded scenes; voxels are voted when they are needed, and nothing is written.

    Arguments as in `choose`; `ignore` names the cells that are unknown, `panorama` as in `ChosenScenes`.

    Raises:
        UserError: naming what does not exist, or scenes that do not have the same classes.
        DataError: when a scene is damaged.
    """
    sequences = {sequence.name: sequence.scene for sequence in find_scenes(Path(folder), scene, None)}
    chosen = choose({name: len(one) for name, one in sequences.items()}, scene, frames, limit, folder)
    pairs = [(sequences[name], wanted) for name, wanted in chosen.items()]
    return scenes_of(pairs, Path(folder), ignore, panorama)


def scenes_of(
    pairs: Sequence[tuple[SceneReader, Sequence[int]]],
    folder: Path,
    ignore: Ignore = "none",
    panorama: Equirectangular | None = None,
) -> ChosenScenes:
    """Return scenes of a folder with the frames of each that are shown; arguments as in `recorded_scenes`.

    Raises:
        UserError: naming scenes that do not have the same classes.
    """
    spec = spec_of(pairs[0][0])
    for other, _ in pairs:
        if spec_of(other).classes != spec.classes:
            raise UserError(f"recorded={folder}: '{other.name}' has other classes than '{pairs[0][0].name}'")
    checksums = digest(sorted([one.name, one.meta["files"]] for one, _ in pairs))
    labels = partial(votes_of, pairs[0][0], ignore=ignore)
    return ChosenScenes(spec, pairs, labels, panorama, f"recorded scenes of {folder}", checksums)


def choose(
    lengths: Mapping[str, int], scene: str | None, frames: Sequence[int] | None, limit: int | None, where: str
) -> dict[str, tuple[int, ...]]:
    """Return the indices of the frames that are shown, by scene.

    Args:
        lengths: number of frames of every scene, by name, in order.
        scene: name of one of them; None: all.
        frames: indices in each scene; None: all.
        limit: number of frames in all, the first ones; None: no limit.
        where: place of the scenes, for messages.

    Raises:
        UserError: naming the scene or frame that does not exist, and those that do.
    """
    if not lengths:
        raise UserError(f"{where} has no test scenes to show")
    names = list(lengths)
    if scene is not None:
        check_scene(scene, names, where)
        names = [scene]
    pairs = [(name, frame) for name in names for frame in chosen_frames(name, lengths[name], frames)]
    if not pairs:
        raise UserError(f"frames={list(frames or [])}: no frames are chosen")
    chosen: dict[str, list[int]] = {}
    for name, frame in pairs[:limit]:
        chosen.setdefault(name, []).append(frame)
    if limit is not None and len(pairs) > limit:
        print(f"the first {limit} of {len(pairs)} frames; limit=null shows all", flush=True)
    return {name: tuple(wanted) for name, wanted in chosen.items()}


def rig_at_sizes(rig: Rig | None, images: Sequence[np.ndarray]) -> Rig | None:
    """Return a rig with each camera, and its mask, at the size of its image; as it is without images."""
    if rig is None or not images:
        return rig
    alone = [
        Rig((camera,), rig.ego_from_camera[:1], ("camera",), (mask,)).resized(image.shape[1], image.shape[0])
        for camera, mask, image in zip(rig.cameras, rig.each_mask, images, strict=True)
    ]
    cameras = tuple(one.cameras[0] for one in alone)
    return replace(rig, cameras=cameras, masks=rig.masks and tuple(one.each_mask[0] for one in alone))


def recorded_frame(
    scenes: ChosenScenes,
    scene: SceneFrames,
    frame: int,
    voxels: Mapping[Grid, Tensor],
    predictions: Mapping[str, FramePrediction],
) -> ShownFrame:
    """Return a recorded frame with its true voxels and predictions."""
    range_m = scene.erp_range_m(frame)
    return ShownFrame(
        scene=scene.name,
        frame=frame_name(frame),
        time_s=time_of(scene, frame, scenes.spec.frame_interval_s),
        images=tuple(scene.images(frame)),
        rig=scene.rigs[frame],
        world_from_ego=scene.world_from_ego[frame],
        truth=voxels,
        range_m=None if range_m is None else torch.from_numpy(range_m),
        panorama=None if range_m is None else scenes.true_panorama(scene, range_m.shape),
        lidar=scene.lidar(frame),
        predictions=predictions,
        evidence=None if scene.points(frame) is None else partial(cell_evidence, scene, frame),
    )
