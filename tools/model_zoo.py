"""Write the table of shipped weights into README.md and docs/weights.md: `python tools/model_zoo.py`.

Scores are those of the cards beside the weights, scenes and steps those of the recipes in `tools/weights`. Parameters,
operations and the time of a frame are measured on a recorded frame of the tests, with one CPU thread.
"""

import re
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from make_weights import FRAMES, ROOT, recipe_of

from omniocc.data.store.reader import SceneReader
from omniocc.predict import load
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.predictor import STEPS, Input, Predictor, predict_depth
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.trained import Trained
from omniocc.report.card import BANDS
from omniocc.report.docs import write_block
from omniocc.runs.cost import GFLOP, PARAMETERS, cost_of_network
from omniocc.runs.folder import git_commit
from omniocc.runs.machine import machine
from omniocc.runs.script import quiet_libraries
from omniocc.runs.table import markdown
from omniocc.runs.weights import SHIPPED, shipped

COMMAND = "python tools/model_zoo.py"
BEGIN, END = f"<!-- Weights, written by `{COMMAND}`; do not edit. -->", "<!-- End of the weights. -->"
"""Lines around the table in its files."""
FILES = {"README.md": "docs/weights.md", "docs/weights.md": "weights.md"}
"""Files that have the table, and the page that its names link to from there."""
HEAD = ["Name", "What", "Training scenes", "Steps of depth / sketch / occupancy", "M parameters", "GFLOP a frame"]
HEAD += ["RayIoU", *(band.replace("m", " m") for band in BANDS), "Seconds a frame", "Use"]
STAGES = ("depth", "sketch", "occupancy")
REPEATS = 5


def training_of(recipe: dict[str, Any]) -> tuple[dict[str, int], dict[str, int]]:
    """Return by stage the steps of a recipe, with those of what it starts from, and the scenes of its last training."""
    values = dict(word.removeprefix("+").split("=", 1) for word in recipe["overrides"])
    steps, scenes = {}, {}
    for stage in STAGES:
        if recipe["stage"] in (stage, STAGES[-1]):
            start = values.get("weights" if stage == STAGES[-1] else f"stages.{stage}.weights")
            before = training_of(recipe_of(Path(start).stem)) if start else ({}, {})
            own = int(values[f"preset.stages.{stage}.max_steps"])
            steps[stage] = own + before[0].get(stage, 0)
            scenes[stage] = int(values["data.source.train_scenes"]) if own else before[1][stage]
    return steps, scenes


def scores_of(card: str) -> list[str]:
    """Return RayIoU of a card, in all and in each distance band; a dash where it has none."""
    rows = dict(
        re.findall(r"^\| (voxel RayIoU.*?) \| (\S+) \|$", card.partition("## On the four frames")[0], re.MULTILINE)
    )
    keys = ["voxel RayIoU", *(f"voxel RayIoU, {band.replace('m', ' m')}" for band in BANDS)]
    return [rows.get(key, "–") for key in keys]


def frame_of(trained: Trained, folder: Path) -> tuple[torch.nn.Module, Callable[[], object]]:
    """Return the network of a checkpoint, and what predicts a recorded frame by it."""
    scene = SceneReader(min(folder.glob("*/meta.json")).parent)
    images, rig, device = scene.images(0), scene.rigs[0], torch.device("cpu")
    width = trained.facts.width_for(rig)
    if trained.stage == "depth":
        batch, scaled = resized_to_width(images, rig, width)
        return trained.depth, lambda: predict_depth(trained.depth, batch, scaled, device)
    predictor = Predictor(trained.occupancy, width, (), device, trained.occupied_above)
    given = Input(*predictor.scaled(images, rig))
    return trained.occupancy, lambda: predictor.step(given, Stopwatch(device, STEPS))


def measured(trained: Trained, folder: Path) -> list[str]:
    """Return parameters (millions), operations (GFLOP) and the median time (s) of a recorded frame."""
    network, run = frame_of(trained, folder)
    cost, times_s = cost_of_network(network, run), []
    for _ in range(REPEATS):
        began_s = time.perf_counter()
        run()
        times_s.append(time.perf_counter() - began_s)
    return [f"{cost[PARAMETERS]:.2f}", f"{cost[GFLOP]:.1f}", f"{statistics.median(times_s):.2f}"]


def row_of(name: str) -> list[str]:
    """Return the line of shipped weights."""
    recipe = recipe_of(name)
    steps, scenes = training_of(recipe)
    parameters, gflop, seconds = measured(load(name), FRAMES / recipe.get("frames", name))
    seen = " / ".join(f"{count:,}" for count in dict.fromkeys(scenes[stage] for stage in STAGES if stage in scenes))
    trained = " / ".join(f"{steps[stage]:,}" if stage in steps else "–" for stage in STAGES)
    scores = scores_of((SHIPPED / f"{name}.md").read_text())
    return [recipe["what"], seen, trained, parameters, gflop, *scores, seconds, f"`{recipe['use']}`"]


def main() -> None:
    """Measure all shipped weights and write the table."""
    quiet_libraries()
    torch.set_num_threads(1)
    place = HEAD.index("RayIoU") - 1
    rows = [(name, row_of(name)) for name in shipped()]
    rows.sort(key=lambda row: row[1][place].strip("–"), reverse=True)  # weights without a score come last
    source = f"`{COMMAND}`, commit {git_commit()}, one thread of {machine(torch.device('cpu'))}."
    for file, page in FILES.items():
        lines = [[f"[`{name}`]({page}#{name})", *cells] for name, cells in rows]
        write_block(ROOT / file, [BEGIN, *markdown(HEAD, lines).splitlines(), "", source, END])


if __name__ == "__main__":
    main()
