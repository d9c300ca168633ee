"""Folders that `predict.py occupancy` has written, with the images, and the truth where they are recorded scenes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omniocc.camera import Rig
from omniocc.data.source import Ignore
from omniocc.data.source.recorded import spec_of, votes_of
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.models import frame_figures, scene_scores
from omniocc.extras.viewer.options import ViewOptions
from omniocc.extras.viewer.scenes import ChosenScenes, choose, recorded_frame, rig_at_sizes
from omniocc.geometry import Grid
from omniocc.predict.input.images import FrameFiles, find_frames, natural_key, read_frame
from omniocc.predict.input.own import is_bag
from omniocc.predict.options import load_rig
from omniocc.predict.output.manifest import OWN_RIG, read_manifest
from omniocc.predict.output.voxel_files import VOXELS, Voxels, read_voxels
from rayiou import sparseocc_directions

if TYPE_CHECKING:
    from omniocc.scores import Scores

OWN_INTERVAL_S = 1.0
"""Time between frames of a user's own images, of which none is known, s."""


def open_predictions(options: ViewOptions) -> Shown:
    """Return the predictions of a folder; frames are read when they are iterated.

    Raises:
        UserError: naming what does not exist or is damaged.
    """
    folder = Path(str(options.predictions))
    facts, found = read_manifest(folder), predicted_frames(folder)
    lengths = {scene: len(names) for scene, names in found.items()}
    chosen = choose(lengths, options.scene, options.frames, options.limit, str(folder))
    frames = [(scene, found[scene][k]) for scene, wanted in chosen.items() for k in wanted]
    first = read_voxels(folder / frames[0][0] / frames[0][1] / VOXELS)
    recorded = recorded_of(facts, list(chosen))
    rig = load_rig(str(folder / OWN_RIG)) if (folder / OWN_RIG).is_file() else None
    road_z_m = next((spec_of(scene).road_z_m for scene in recorded.values()), rig and rig.road_z_m)
    interval_s = next((spec_of(scene).frame_interval_s for scene in recorded.values()), OWN_INTERVAL_S)
    ignore: Ignore = facts.get("ignore") or "none"
    read = partial(_frames, folder, frames, first, recorded, ignore, rig=rig, own=own_frames(facts, rig))
    return Shown(
        classes=first.classes,
        models=(folder.resolve().name,),
        grids=(first.geometry,),
        road_z_m=first.geometry.bounds[2][0] if road_z_m is None else road_z_m,
        frame_interval_s=interval_s,
        directions=sparseocc_directions(),
        source=f"predictions in {folder}",
        fingerprint=str(facts.get("checkpoint")),
        frames=tuple(frames),
        read=read,
    )


def predicted_frames(folder: Path) -> dict[str, list[str]]:
    """Return the names of the predicted frames by scene; the scene of a user's own images has no name."""
    found: dict[str, list[str]] = {}

    def in_order(path: Path) -> list[list[tuple[int, str]]]:
        return [natural_key(Path(part)) for part in path.relative_to(folder).parts]

    for path in sorted(folder.rglob(VOXELS), key=in_order):
        *scene, name = path.parent.relative_to(folder).parts or ("",)
        found.setdefault("/".join(scene), []).append(name)
    if not found:
        raise UserError(f"{folder} holds no finished predictions ({VOXELS})")
    return found


def recorded_of(facts: Mapping[str, Any], names: Sequence[str]) -> dict[str, SceneReader]:
    """Return the recorded scenes that were predicted and are still there, by name; none for a user's own images."""
    data = Path(str(facts.get("images")))
    if facts.get("rig") is not None or not data.is_dir():
        return {}
    one = (data / META).is_file()  # `recorded=` named a single scene, not a dataset
    folders = [data] if one else [data / name for name in names if name and (data / name / META).is_file()]
    return {scene.name: scene for scene in map(SceneReader, folders)}


def own_frames(facts: Mapping[str, Any], rig: Rig | None) -> dict[str, FrameFiles]:
    """Return the image files of a user's own frames by name; none if they are in a bag, or not there any more."""
    images = facts.get("images")
    if rig is None or not isinstance(images, str) or not Path(images).is_dir() or is_bag(images):
        return {}
    frames = find_frames(images, rig, facts.get("exclude_cameras") or (), facts.get("image_bits"))
    return {frame.name: frame for frame in frames}


def _frames(
    folder: Path,
    frames: Sequence[tuple[str, str]],
    first: Voxels,
    recorded: Mapping[str, SceneReader],
    ignore: Ignore,
    rig: Rig | None,
    own: Mapping[str, FrameFiles],
) -> Iterator[ShownFrame]:
    model, scores = folder.resolve().name, lru_cache(maxsize=1)(scene_scores)
    for number, (scene, name) in enumerate(frames):
        path = folder / scene / name / VOXELS
        voxels = read_voxels(path)
        if voxels.geometry != first.geometry or voxels.classes != first.classes:
            raise UserError(f"{path} has another grid or other classes than the first frame")
        if scene in recorded:
            yield _recorded(recorded[scene], int(name), voxels, model, ignore, scores)
        else:
            images = read_frame(own[name], rig) if rig is not None and name in own else []
            yield ShownFrame(
                scene=scene,
                frame=name,
                time_s=number * OWN_INTERVAL_S,
                images=tuple(images),
                rig=rig_at_sizes(rig, images),
                world_from_ego=voxels.world_from_ego,
                predictions={model: _prediction(voxels, {})},
            )


def _recorded(
    scene: SceneReader,
    frame: int,
    voxels: Voxels,
    model: str,
    ignore: Ignore,
    scores: Callable[[Grid, SceneReader], "Scores"],
) -> ShownFrame:
    """Return a predicted frame of a recorded scene, scored where there is truth; `ignore` as in its training."""
    spec, grid = spec_of(scene), voxels.geometry
    labels = partial(votes_of, scene, ignore=ignore)
    scenes = ChosenScenes(spec, [(scene, [frame])], labels, None, scene.name, "")
    truth = scenes.truth(scene, frame, grid)
    figures = {} if truth is None else frame_figures(scores(grid, scene), voxels.labels, truth)
    known = {} if truth is None or truth.voxels is None else {grid: truth.voxels[0]}
    return recorded_frame(scenes, scene, frame, known, {model: _prediction(voxels, figures)})


def _prediction(voxels: Voxels, figures: Mapping[str, float]) -> FramePrediction:
    return FramePrediction(voxels.labels, voxels.geometry, voxels.candidates, figures=figures)
