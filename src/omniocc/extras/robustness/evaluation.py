"""The robustness test of one checkpoint: every part is scored on the same scenes, and written when it is finished."""

import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from omegaconf import OmegaConf

from omniocc.camera import Rig
from omniocc.camera.miscalibrated import has_centre
from omniocc.config import plain
from omniocc.data import Needs, OccupancyData, SceneSource, WindowDataset, collate
from omniocc.data.loader import Loader
from omniocc.data.source import MadeScenes, SceneFrames
from omniocc.errors import UserError, installing
from omniocc.evaluate import Evaluation, load_with_overrides, results_folder, score_each, system_name
from omniocc.extras.robustness.disturbance import disturb_scene
from omniocc.extras.robustness.parts import NO_UNSEEN, VERSION, Part, chosen, parts_of
from omniocc.io import atomic_write
from omniocc.model.protocols import takes_true_range
from omniocc.parts import Parts
from omniocc.progress import Progress
from omniocc.report.tables.formats import parts_text
from omniocc.report.tables.robustness import report_parts, robustness_csv
from omniocc.runs.checkpoint import Checkpoint
from omniocc.runs.folder import command_line, git_commit, short_hash
from omniocc.runs.robustness import FOLDER, WITHIN, PartScores, Robustness, load_part, save_part, save_robustness
from omniocc.runs.script import train_config
from omniocc.runs.table import in_columns
from omniocc.runs.wandb import Loggers
from omniocc.runs.wandb.loggers import log_robustness
from omniocc.runs.weights import digest_of
from omniocc.scores import Scores
from omniocc.train.occupancy import OccupancyTask, predictions

KEYS = ("rayiou", "lidar/rayiou", "voxel/iou", "voxel/miou")
"""Scores that are kept, besides RayIoU within nested ranges."""
DIGITS = 6
"""Decimals of the scores, so that those of a kept part are those of a computed one."""


def robustness_of(
    task: OccupancyTask,
    data: OccupancyData,
    checkpoint: Checkpoint,
    wanted: Sequence[str],
    scenes: int,
    seed: int,
    folder: Path,
) -> Robustness:
    """Return the scores of the trained task in a checkpoint under disturbances; finished parts are in `folder`.

    Args:
        task: with the checkpoint's weights.
        data: of its configuration, which may be changed.
        checkpoint: with the configuration of the training.
        wanted: `all`, or names of parts or of kinds of disturbances.
        scenes: number of test scenes, 1 or more.
        seed: of all random draws, 0 or more.
        folder: of the finished parts, one file each.

    Raises:
        UserError: when a part does not exist or cannot be had, a number is too small, or a file is damaged.
        DataError: when scenes cannot be made or the disk refuses.
    """
    if scenes < 1 or seed < 0:
        raise UserError(f"scenes={scenes} and seed={seed}: give at least one scene, and a seed that is not negative")
    check_depth(task)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    test = RobustnessTest(task, data, plain(checkpoint.config)["data"]["source"], scenes, seed, device)
    every = test.parts()
    parts, left_out = chosen(wanted, every), []
    if lost := test.lost([part for part in parts if part.source]):
        if "all" not in wanted:
            raise UserError(lost)
        parts, left_out = [part for part in parts if not part.source], [lost]
    if lenses := test.without_centre():
        if "all" not in wanted and any(part.group == "focal" for part in parts):
            raise UserError(lenses)
        parts, left_out = [part for part in parts if part.group != "focal"], [*left_out, lenses]
    if "all" in wanted and test.renders and not test.unseen:
        left_out.append(NO_UNSEEN)
    for line in left_out:
        print(f"left out: {line}", flush=True)
    scored = test.run(parts, every, folder)
    setting = short_hash([test.source({}).fingerprint, list(scored[0].scenes), seed, *test.unusual()])
    facts = {"command": command_line(), "commit": git_commit(), "machine": computed_on(device)}
    facts |= {"checkpoint": checkpoint.path.name, "seed": seed, "setting": setting, "left out": left_out}
    return Robustness(system_name(checkpoint.path), facts, scored)


def computed_on(device: torch.device) -> str:
    """Return what the test was computed on, in words."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{platform.machine()}, threads: {torch.get_num_threads()}"


@dataclass(frozen=True)
class RobustnessTest:
    """The parts, scenes and seed of a test of one checkpoint.

    Attributes:
        task: trained, in evaluation mode.
        data: of its configuration.
        trained_on: options of the source of its training.
        scenes: number of test scenes; the first ones, as many as there are.
        seed: of all random draws of the disturbances.
        device: to compute on.
    """

    task: OccupancyTask
    data: OccupancyData
    trained_on: Mapping[str, Any]
    scenes: int
    seed: int
    device: torch.device

    @property
    def unseen(self) -> tuple[str, ...]:
        """Return the kinds of places that were left out of the training; none for other sources."""
        return tuple(self.trained_on.get("test_places", ()))

    @property
    def renders(self) -> bool:
        """Return whether the test scenes can be rendered anew with other options."""
        source = self.data.source
        return isinstance(source, MadeScenes) and source.made_here

    def parts(self) -> list[Part]:
        """Return all parts for the cameras of the first test scene."""
        return parts_of(self.rig.names, self.unseen)

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras of the first test scene, which is rendered if it is missing."""
        return self.prepared({}).scenes("test")[0].rigs[0]

    def lost(self, rendered: Sequence[Part]) -> str:
        """Return in words which of the parts that render scenes anew this data cannot have; empty if there is none."""
        if self.renders or not rendered:
            return ""
        groups = ", ".join(dict.fromkeys(part.group for part in rendered))
        return f"{groups}: only scenes that the virtual world renders on this machine can be rendered anew"

    def without_centre(self) -> str:
        """Return a line if a camera has no optical centre, so that no focal length can be wrong; else none."""
        names = {type(camera).__name__ for camera in self.rig.cameras if not has_centre(camera)}
        return f"focal: images of {', '.join(sorted(names))} have no centre" if names else ""

    def source(self, changes: Mapping[str, Any]) -> SceneSource:
        """Return the source of the test scenes with other options, in places that the checkpoint was trained on.

        Only for the virtual world there are other options and places; its scenes may not be rendered yet.
        """
        if not isinstance(self.data.source, MadeScenes):
            self.data.source.prepare()
            return self.data.source
        own = self.task.config["data"]["source"]
        named = map(str, self.trained_on["themes"])  # from the file; nothing else than names is built from them
        places = {"themes": [place for place in named if place not in self.unseen]}
        count = min(self.scenes, own["test_scenes"])
        numbers = {"train_scenes": 0, "val_scenes": 0, "test_scenes": count, "test_places": []}
        return Parts(OmegaConf.create({"data": {"source": {**own, **places, **numbers, **changes}}})).source()

    def prepared(self, changes: Mapping[str, Any]) -> SceneSource:
        """Return the same source after its scenes and labels have been made.

        Raises:
            DataError: when scenes are missing and cannot be made.
        """
        source = self.source(changes)
        if changes and isinstance(source, MadeScenes) and source.missing():
            print(f"test scenes are rendered with {' '.join(f'{key}={value}' for key, value in changes.items())}")
        source.prepare()
        source.labels(self.data.geometry, self.data.ignore).prepare(source.scenes("test"))
        return source

    def run(self, parts: Sequence[Part], every: Sequence[Part], folder: Path) -> list[PartScores]:
        """Return the scores of parts, and of those of `every` part that the folder already holds.

        What the folder holds under the same key is not computed again. All scenes are rendered first.

        Raises:
            UserError: naming a damaged file.
            DataError: when scenes cannot be made or the disk refuses.
        """
        weights = digest_of({name: value.cpu() for name, value in self.task.state_dict().items()})
        sources = {part.options: part.source for part in every}
        data = {options: self.source(changes).fingerprint for options, changes in sources.items()}
        keys = {part.name: self.key(part, weights, data[part.options]) for part in every}
        found = {part.name: load_part(folder / f"{part.name}.json", keys[part.name]) for part in every}
        missing = [part for part in parts if found[part.name] is None]
        rendered = {part.options: part.source for part in missing}
        ready = {options: self.prepared(changes) for options, changes in rendered.items()}
        work = [(part, ready[part.options]) for part in missing]
        frames = sum(len(scene) for _, source in work for scene in self._scenes(source))
        with Progress("robustness", frames) as progress:
            for number, (part, source) in enumerate(work, start=1):
                text = f"{part.name}, part {number} of {len(work)}"
                scored = self.score(part, source, partial(progress.advance, text=text))
                save_part(folder / f"{part.name}.json", scored, keys[part.name])
                found[part.name] = scored
        return [scored for part in every if (scored := found[part.name]) is not None]

    def key(self, part: Part, weights: str, data: str) -> str:
        """Return a hash of everything that decides the figures of a part; `weights` is that of the model's.

        `data` is the fingerprint of the frames that it is tested on.
        """
        model = self.task.config["model"]
        return short_hash([VERSION, weights, model, data, self.scenes, part.name, self.seed, *self.unusual()])

    def unusual(self) -> list[Any]:
        """Return what else changes scores, where it is not as usual: unknown cells, history, bands, rays, threshold."""
        found, bands = [self.data.ignore, self.data.window], self.data.range_edges_m
        usual = found == ["none", self.task.model.temporal.frames]
        rays = [] if self.data.ray_azimuths is None else [["rays", self.data.ray_azimuths]]
        above = [] if self.task.occupied_above is None else [["above", self.task.occupied_above]]
        return ([] if usual and bands is None else found) + ([] if bands is None else [list(bands)]) + rays + above

    @torch.inference_mode()
    def score(self, part: Part, source: SceneSource, advance: Callable[[], None]) -> PartScores:
        """Return the scores of one part; the model computes everything from the disturbed frames.

        `advance` is called after every frame.
        """
        started = time.monotonic()
        recorded = self._scenes(source)
        scenes = [disturb_scene(scene, part.disturbance, part.name, self.seed) for scene in recorded]
        data, spec = self.data, self.data.spec
        labels = source.labels(data.geometry, data.ignore)
        needs = Needs(pixel_labels=False)
        windows = WindowDataset(scenes, labels, data.window, needs, spec.lidar_directions is None)
        loader = Loader(windows, 1, data.num_workers, collate)
        by_scene = {scene.name: Scores(self.task.model.geometry, spec).to(self.device) for scene in recorded}
        for batch, labels in predictions(self.task, loader, self.device):
            by_scene[batch.frame_ids[0].rsplit("/", 1)[0]].update(labels, batch)
            advance()
        scores, without = with_each_left_out(list(by_scene.values()))
        seconds = round(time.monotonic() - started, 1)
        return PartScores(part.name, part.group, list(by_scene), len(windows), seconds, scores, without=without)

    def _scenes(self, source: SceneSource) -> Sequence[SceneFrames]:
        return source.scenes("test")[: self.scenes]


def check_depth(task: OccupancyTask) -> None:
    """Raise UserError if a model's ranges are the recorded ones, which no disturbance would change."""
    if takes_true_range(task.model.sketch):
        raise UserError(
            "the ranges of this checkpoint are the recorded ones (model/depth=truth): nothing disturbs them"
        )


def with_each_left_out(scores: Sequence[Scores]) -> tuple[dict[str, float], dict[str, list[float]]]:
    """Return the figures over all scenes, and over all but each of them, by key; nothing for a single scene.

    A figure is nan where the scenes that are left have no labels for it.
    """
    whole = figures(merged(scores))
    rest = [figures(merged([*scores[:k], *scores[k + 1 :]])) for k in range(len(scores))] if len(scores) > 1 else []
    return whole, {key: [one.get(key, math.nan) for one in rest] for key in whole}


def merged(scores: Sequence[Scores]) -> Scores:
    """Return the scores of several sets of frames together."""
    whole = deepcopy(scores[0])
    for more in scores[1:]:
        whole.merge(more)
    return whole


def figures(scores: Scores) -> dict[str, float]:
    """Return the scores that are kept, those of them that the frames have labels for."""
    found = scores.compute()
    if "rayiou" in found:
        found |= scores.rays.compute_within()
    kept = {key: float(value) for key, value in found.items() if key in KEYS or key.startswith(WITHIN)}
    return {key: round(value, DIGITS) for key, value in kept.items()}


def score_robustness(options: Evaluation) -> None:
    """Score checkpoints under disturbances; write and log the results, print the comparison.

    Raises:
        UserError: when no checkpoint is named, and with the messages of those that cannot be scored.
    """
    if not options.checkpoints:
        raise UserError("name a checkpoint, or a shipped file of weights")
    logging = [word for word in options.overrides if word.startswith("logger.")]
    others = [word for word in options.overrides if word not in logging]
    logger: Loggers = Parts(train_config(logging)).loggers()
    records: list[Robustness] = []

    def score(checkpoint: Path) -> None:
        folder = results_folder(checkpoint, f"{FOLDER}{checkpoint.stem}", options.output, True)
        one, wanted = load_with_overrides(checkpoint, others), options.robustness or ()
        record = robustness_of(one.task, one.data, one.checkpoint, wanted, options.scenes, options.seed, folder=folder)
        save_robustness(folder, record)
        atomic_write(folder / "table.md", parts_text(report_parts([record])))
        atomic_write(folder / "table.csv", robustness_csv([record], {}))
        log_robustness(logger.build(folder, one.task.config, "robustness"), record, draw([record], folder))
        records.append(record)
        print(f"table     {folder / 'table.md'}", flush=True)

    try:
        score_each(options.checkpoints, score)
    finally:
        if records:
            tables = [f"{in_columns(*part.cells)}\n\n{part.note}" for part in report_parts(records)]
            print("\n\n".join(["", *tables, "all systems: python src/report.py"]))


def draw(records: Sequence[Robustness], folder: Path) -> np.ndarray | None:
    """Write the plot of a test, and return it as an RGB image; None without matplotlib."""
    if find_spec("matplotlib") is None:
        print(f"No plot: matplotlib is missing: {installing('plot')}")
        return None
    from omniocc.report.plots import as_png, drops

    path = folder / "robustness.png"
    atomic_write(path, png := as_png(drops(records)))
    return cv2.cvtColor(np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)
