"""Train the weights in the package further for one's own cameras, in a given time: the work of `src/adapt.py`."""

import json
import math
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, cast

import torch
from omegaconf import DictConfig, OmegaConf

from omniocc.config import plain, quoted
from omniocc.data.dataset import read_images
from omniocc.data.source import MadeScenes, SceneSource
from omniocc.data.source.cameras import first_rig, frames_in, training_frames
from omniocc.errors import UserError
from omniocc.evaluate import Evaluation, score_checkpoint
from omniocc.io import atomic_write
from omniocc.parallel import usable_cores
from omniocc.parts import Parts
from omniocc.predict.input.images import even_size
from omniocc.predict.input.sequence import with_road
from omniocc.predict.options import load_rig
from omniocc.predict.trained import PLACE_ARGUMENTS, Trained
from omniocc.progress import clock
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.checkpoint_io import BEST
from omniocc.runs.folder import run_folder, short_hash
from omniocc.runs.results import EVALUATION, IMAGES, METRICS, load_results
from omniocc.runs.script import train_config
from omniocc.runs.table import BASELINE, BOUND, comparison_cells, in_columns, markdown
from omniocc.train.command import step_seconds, train
from omniocc.train.depth import DepthTask
from omniocc.train.stage import Stage
from omniocc.train.stages import predict_range_m, stages_of

START = "any-rig"
"""Weights from which all stages start, and the beginning of the options in `conf/adapt`."""
PIXELS = 256 * 144
"""Of an image, as many as of the images that these weights were trained with."""
ORIGIN_ABOVE_ROAD_M, ROAD_WITHIN_M = 2.2, 0.2
"""Height at which these weights expect the origin, as in `conf/adapt`, and how much another one may differ."""
FEWEST_MINUTES = 5.0
START_S, TEST_SHARE, FRAMES_SHARE = 60.0, 0.15, 0.25
"""Seconds for starts and the test of the weights as they are; of all time, about this for validation and tests, and at
most this for making training frames and their ranges."""
SHARES = {"depth": 0.3, "sketch": 0.15, "occupancy": 0.55}
"""Fractions of the time that is left for training, by stage; the time of one that does not train is shared."""
SCENES = 16, 480
"""Fewest and most training streets."""
STEP = 10
"""Steps are a multiple of this, so that a training is validated five times."""


class Plan(NamedTuple):
    """How the time is used.

    Attributes:
        train_scenes: streets of the virtual world for training; None for recordings.
        steps: of each stage that is trained.
    """

    train_scenes: int | None
    steps: dict[str, int]

    @property
    def overrides(self) -> list[str]:
        """Return the overrides of `src/train.py`."""
        scenes = [] if self.train_scenes is None else [f"data.source.train_scenes={self.train_scenes}"]
        return [*scenes, *(f"stages.{stage}.max_steps={steps}" for stage, steps in self.steps.items())]


def adapt(rig: str | None, road_z_m: float | None, minutes: float, words: Sequence[str]) -> None:
    """Plan the time, train, test on other streets, print a table and the command that predicts with the result.

    The plan is kept: the same call goes on after a stop. With `plan=true` among the words it is printed only.

    Args:
        rig: rig file, or calibration file of another tool; None for recordings, which have a rig.
        road_z_m: height of the road in the frame of the rig, m; None: as the rig file says.
        minutes: from the first line to the table, about.
        words: further overrides of `src/train.py`, such as `data=recorded`.

    Raises:
        UserError: when the time is too short, there are neither cameras nor recordings, or the height of the road is
            not known.
    """
    if not minutes >= FEWEST_MINUTES:
        raise UserError(f"minutes={minutes:g}: at least {FEWEST_MINUTES:g} are needed")
    if any(word.startswith("data=") for word in words) != (rig is None):
        raise UserError("give your cameras, rig=my_rig.yaml, or recordings, data=recorded data.source.root=my_scenes")
    if rig is not None and road_z_m is not None:
        rig = with_road_in_file(rig, road_z_m, Path(train_config(words).paths.runs))
    base = [f"+adapt={START}-recorded"] if rig is None else [f"+adapt={START}", *rig_overrides(rig)]
    base += words
    cfg = train_config(base)
    source = Parts(cfg).source()
    if rig is None:
        check_road(source)
    folder = Path(cfg.paths.runs) / f"adapt-{short_hash([base, source.fingerprint, minutes])}"
    file = folder / "plan.json"
    if file.is_file():
        plan = Plan(**json.loads(file.read_text("utf-8")))
    else:
        plan = planned(cfg, source, 60 * minutes)
        if cfg.plan:
            return
        atomic_write(file, json.dumps(plan._asdict()))
    shipped = as_they_are(cfg, file.parent / f"{EVALUATION}{START}")
    after = trained([*base, *plan.overrides])
    figures = load_results(after)[1]
    rows = {
        BASELINE: (figures, "prior"),
        f"weights '{START}' as they are": (shipped, "test"),
        f"adapted, {minutes:g} min": (figures, "test"),
        BOUND: (figures, "label"),
    }
    table = comparison_cells({row: (found, prefix) for row, (found, prefix) in rows.items() if found is not None})
    atomic_write(after / "adapted.md", markdown(*table))
    print("\n" + in_columns(*table))
    print(f"images    {after / IMAGES}")
    what = "recorded=my_scenes" if rig is None else f"rig={shlex.quote(rig)} images=my_images"
    print(f"predict   python src/predict.py occupancy checkpoint={after / BEST} {what} output=adapted")


def as_they_are(cfg: DictConfig, folder: Path) -> dict[str, float] | None:
    """Return the scores of the weights on the test scenes of other data, on their own grid; computed once for a folder.

    None where the data has other classes than the weights.
    """
    content = load_checkpoint(START)
    if cfg.data.num_classes != content.config.data.num_classes:
        return None
    if not (folder / METRICS).is_file():
        print(f"weights   '{START}' as they are", flush=True)
        own = content.config.data
        changed = {"data": {**plain(cfg)["data"], "geometry": own.geometry, "window": own.window}}
        config = OmegaConf.create({**content.config, **changed})
        given = tuple(f"data.source.{key}" for key in PLACE_ARGUMENTS)
        options = Evaluation([content.path], [], None, None)
        score_checkpoint(Trained(content, config, given, tuple(cfg.packages)), folder, options)
    return load_results(folder)[1]


def with_road_in_file(rig: str, road_z_m: float, runs: Path) -> str:
    """Return a rig file in the folder of runs that states the height of the road, after writing it."""
    stated = with_road(load_rig(rig), road_z_m)
    file = runs / f"rig-{stated.fingerprint[:8]}-{road_z_m:g}.yaml"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        stated.save(file)
    return str(file)


def rig_overrides(rig: str) -> list[str]:
    """Return the overrides that make the virtual world record with a rig, at the size of the images in training.

    Raises:
        UserError: when the rig cannot be read, or its file does not state the height of the road.
    """
    own = load_rig(rig)
    if own.road_z_m is None and Path(rig).exists():
        raise UserError(f"rig={rig} does not state the height of the road in its frame, m: give road_z_m=-0.9")
    first = own.cameras[0]
    scale = math.sqrt(PIXELS / (first.width * first.height))
    width, height = even_size(first, round(scale * first.width))
    return [f"data.source.rig={quoted(rig)}", f"data.source.image_size=[{width},{height}]"]


def check_road(source: SceneSource) -> None:
    """Raise UserError if recorded scenes have the road at another height than the weights expect it."""
    source.prepare()
    road_z_m = source.spec.road_of(first_rig(source))
    if road_z_m is not None and abs(road_z_m + ORIGIN_ABOVE_ROAD_M) > ROAD_WITHIN_M:
        raise UserError(
            f"{source.folder}: the road is {-road_z_m:g} m below the origin, and these weights expect it at "
            f"{ORIGIN_ABOVE_ROAD_M} m: record the scenes with recorder.origin_above_road_m={ORIGIN_ABOVE_ROAD_M}"
        )


def planned(cfg: DictConfig, source: SceneSource, seconds: float) -> Plan:
    """Measure what a frame and a step cost on this machine, and share the time; what is rendered for it is used later.

    Raises:
        UserError: when no time is left for training.
    """
    print(f"plan      some frames and steps are timed, to fill {clock(seconds)}", flush=True)
    parts = Parts(cfg)
    begin_s = time.monotonic()
    stages = {stage.NAME: stage for stage in stages_of(parts, parts.data())}
    steps_s = {name: step_seconds(stages[name]) for name in SHARES if stages[name].recipe.max_steps}
    alone = parts.source(workers=0)
    frame_s, frame_bytes = frame_cost(alone, stages["depth"])
    left_s = (1 - TEST_SHARE) * seconds - START_S - (time.monotonic() - begin_s)
    others = sum(frames_in(source, split) for split in ("val", "test"))
    scenes = None
    frames = training_frames(source)
    if isinstance(source, MadeScenes):
        each = frames // len(source.planned("train"))
        fitting = int((FRAMES_SHARE * seconds / frame_s - others) / each)
        scenes = min(max(fitting, SCENES[0]), SCENES[1])
        frames = scenes * each
    frames_s = (frames + others) * frame_s
    left_s -= frames_s
    whole = sum(SHARES[name] for name in steps_s)
    steps = {name: int(SHARES[name] / whole * left_s / each_s) // STEP * STEP for name, each_s in steps_s.items()}
    if min(steps.values()) < STEP:
        raise UserError(f"minutes={seconds / 60:g}: no time is left for training on this machine; give more")
    made = f"{clock(frames_s)}, {(frames + others) * frame_bytes / 1e6:.0f} MB in {source.folder}"
    print(f"          {frames} frames for training and {others} of other streets: {made}")
    for name, count in steps.items():
        print(f"          {name} {count} steps of {steps_s[name]:.2f} s: {clock(count * steps_s[name])}")
    rest_s = seconds - frames_s - sum(count * steps_s[name] for name, count in steps.items())
    print(f"          starts, this timing, validation and tests: {clock(rest_s)}")
    return Plan(scenes, steps)


def frame_cost(alone: SceneSource, depth: Stage) -> tuple[float, float]:
    """Return the seconds that a frame and its ranges take on all cores, and its bytes on the disk.

    `alone` is a source without processes of its own, whose start would take longer than two scenes.
    """
    made_s, size = 0.0, 0.0
    if isinstance(alone, MadeScenes):
        for name in list(alone.planned("train"))[:2]:  # the first one imports and compiles
            begin_s = time.monotonic()
            (scene,) = alone.made("train", [name])
            made_s = (time.monotonic() - begin_s) / len(scene) / usable_cores()
        size = sum(file.stat().st_size for file in alone.folder.glob("train-*/*")) / 2 / len(scene)
    else:
        scene = alone.scenes("train")[0]
    task = depth.task(scene.rigs[0]).eval()
    with torch.inference_mode():
        for _ in range(2):  # the first one makes tables of the rig
            begin_s = time.monotonic()
            predict_range_m(cast(DepthTask, task), scene.rigs[0], read_images(scene, 0).unsqueeze(0), None)
    return made_s + time.monotonic() - begin_s, size


def trained(overrides: Sequence[str]) -> Path:
    """Run a training, unless it is finished, and return its folder."""
    print(f"command   python src/train.py {shlex.join(overrides)}", flush=True)
    cfg = train_config(overrides)
    train(cfg)
    parts = Parts(cfg)
    return run_folder(Path(cfg.paths.runs), parts.config, parts.source().fingerprint)
