"""Train the weights that come with the package and pack each with a card: `make weights` (NAME=tiny: one of them).

The recipes are in `tools/weights`. Training goes on where it was stopped; what is finished is not trained again.
"""

import json
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, cast

import torch
import yaml
from omegaconf import DictConfig, OmegaConf

from omniocc.data.dataset import read_images
from omniocc.data.source import SceneFrames
from omniocc.data.store.reader import SceneReader
from omniocc.errors import UserError
from omniocc.io import atomic_write, checked_name
from omniocc.metric import DepthMetrics
from omniocc.parts import Parts
from omniocc.predict import load
from omniocc.predict.trained import Trained
from omniocc.report.card import card
from omniocc.runs.checkpoint import Checkpoint, load_checkpoint
from omniocc.runs.checkpoint_io import BEST, LAST
from omniocc.runs.folder import run_folder
from omniocc.runs.results import EARLIER_MINUTES, METRICS, MINUTES, load_results
from omniocc.runs.scenes import scene_figures
from omniocc.runs.script import quiet_libraries, train_config
from omniocc.runs.weights import SHIPPED, SUFFIX, digest_of, pack_weights, read_weights
from omniocc.train.depth import FARTHEST_M
from omniocc.train.stage_keys import stage_keys
from omniworld import VirtualWorld

ROOT = Path(__file__).parents[1]
RECIPES = ROOT / "tools" / "weights"
LIMIT_MB = 12.0
"""Greatest size of a file."""
FRAMES = ROOT / "tests" / "weights"
"""Four recorded frames for each file of weights, on which it must always give the figures of its card."""


def recipe_of(name: str) -> dict[str, Any]:
    """Return a recipe, on top of the one that it is like; raise UserError if none can have the name."""
    path = RECIPES / f"{checked_name('NAME', name)}.yaml"
    if not path.is_file():
        raise UserError(f"NAME={name}: choose one of {', '.join(sorted(file.stem for file in RECIPES.glob('*.yaml')))}")
    own = yaml.safe_load(path.read_text())
    recipe = (recipe_of(own["like"]) if "like" in own else {"overrides": []}) | own
    recipe["overrides"] = [*recipe["overrides"], *recipe.pop("more_overrides", [])]
    if "starts_from" in own:
        recipe["overrides"].append(
            f"stages.{recipe['stage']}.weights={file_of(own['starts_from'], True).relative_to(ROOT)}"
        )
    return recipe


def file_of(name: str, is_start: bool) -> Path:
    """Return the place of a file of weights: beside its recipe if others start from it, else in the package."""
    return (RECIPES if is_start else SHIPPED) / f"{name}{SUFFIX}"


def config_of(recipe: dict[str, Any]) -> DictConfig:
    """Return the configuration of a recipe's training."""
    return train_config(recipe["overrides"])


def folder_of(recipe: dict[str, Any], runs: Path) -> tuple[Path, str]:
    """Return the folder of a recipe's finished run or stage, and the name of its checkpoint."""
    cfg = config_of(recipe)
    parts = Parts(cfg)
    fingerprint = parts.source().fingerprint
    if recipe["stage"] == "occupancy":
        return run_folder(runs, parts.config, fingerprint), BEST
    keys = stage_keys(cfg, fingerprint)._asdict()
    return runs / "stages" / f"{recipe['stage']}-{keys[recipe['stage']]}", LAST


def train(recipe: dict[str, Any]) -> str:
    """Run the recipe's training to its end and return its command; raise UserError if it fails."""
    command = ["python", "src/train.py", *recipe["overrides"]]
    if subprocess.run([sys.executable, *command[1:]], cwd=ROOT, check=False).returncode:
        raise UserError("the training stopped; the same command goes on")
    return shlex.join(command)


def record_frames(trained: Trained, folder: Path) -> None:
    """Record two frames of each of two test scenes of the data of weights, unless they are there."""
    if folder.is_dir():
        return
    counts = {"train_scenes": 0, "val_scenes": 0, "test_scenes": 2, "frames_per_scene": 2}
    with tempfile.TemporaryDirectory() as place:
        source = cast(VirtualWorld, Parts(trained.config).source(root=place, **counts))
        source.prepare()
        shutil.copytree(source.folder, folder, ignore=shutil.ignore_patterns(".*"))


def figures_of(weights: Path, frames: Path) -> dict[str, float]:
    """Return the scores of a file of weights on recorded frames."""
    if load(weights).stage == "depth":
        return range_errors(weights, [SceneReader(meta.parent) for meta in sorted(frames.glob("*/meta.json"))])
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, str(ROOT / "src" / "predict.py"), "occupancy", f"checkpoint={weights}"]
        command += [f"recorded={frames}", f"output={place}", "overview=false", "mesh=false", "device=cpu"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return json.loads((Path(place) / METRICS).read_text())["metrics"]


@torch.inference_mode()
def range_errors(weights: Path, scenes: list[SceneFrames]) -> dict[str, float]:
    """Return the errors of a depth network on all frames of recorded scenes, with the keys of its stage."""
    trained = load(weights)
    model = trained.depth
    spheres = cast(Any, model).rig_spheres(scenes[0].rigs[0])
    errors = DepthMetrics(spheres.min_range_m, FARTHEST_M, spheres.count, trained.data.spec.range_edges_m)
    for scene in scenes:
        for frame in range(len(scene)):
            images = read_images(scene, frame).unsqueeze(0)
            true_m = torch.from_numpy(cast(Any, scene.erp_range_m(frame))).unsqueeze(0)
            errors.update(model(images, (scene.rigs[frame],)).range_m, true_m)
    return {f"test/depth/{key}": float(value) for key, value in errors.compute().items()}


def write(name: str, recipe: dict[str, Any], trained: Checkpoint, made: dict[str, Any]) -> Path:
    """Write a file of weights with the changes of its recipe and facts about it, and return the file."""
    for key, value in recipe.get("shipped", {}).items():
        OmegaConf.update(trained.config, key, value, force_add=True)
    path = file_of(name, recipe.get("is_start", False))
    config = OmegaConf.to_container(trained.config)
    pack_weights(path, trained.stage, config, trained.weights, made, recipe["half"])  # type: ignore[arg-type]
    return path


def pack(name: str, recipe: dict[str, Any], folder: Path, checkpoint: str, command: str) -> Path:
    """Write the file of weights of a training and its card, and return the file."""
    facts, metrics = load_results(folder)
    made = {"command": command, "commit": facts["commit"], "data": facts["data"][:12], "steps": facts["steps"]}
    made |= {key: facts[key] for key in ("seed", EARLIER_MINUTES, MINUTES) if key in facts}
    path = write(name, recipe, load_checkpoint(folder / checkpoint), made)
    if "occupied_above" in recipe.get("shipped", {}):  # the run's test takes the most likely class of every cell
        folder = folder / "shipped"
        evaluate = [sys.executable, "src/evaluate.py", str(path), "--output", str(folder)]
        subprocess.run(evaluate, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        ranges = {key: value for key, value in metrics.items() if key.startswith("test/depth/")}
        metrics = load_results(folder)[1] | ranges
    write_card(name, recipe, path, made, metrics | scene_figures(folder))
    return path


def write_card(name: str, recipe: dict[str, Any], path: Path, made: dict[str, Any], metrics: dict[str, float]) -> None:
    """Write the card beside a file of weights; raise UserError if the file is too large to be shipped."""
    size_mb = path.stat().st_size / 1e6
    if size_mb > LIMIT_MB:
        raise UserError(f"{path} has {size_mb:.1f} MB; at most {LIMIT_MB} MB can be shipped")
    made |= {"size": f"{size_mb:.1f} MB", "sha256": digest_of(read_weights(path)[0]["state_dict"])}
    frames = FRAMES / recipe.get("frames", name)
    record_frames(load(path), frames)
    atomic_write(path.with_suffix(".md"), card(name, recipe, made, metrics, figures_of(path, frames)))


def main(names: list[str]) -> None:
    """Make the weights of these names, or of all recipes."""
    quiet_libraries()
    for name in names or sorted(
        path.stem for path in RECIPES.glob("*.yaml") if not recipe_of(path.stem).get("is_start")
    ):
        recipe = recipe_of(name)
        if "starts_from" in recipe and not file_of(recipe["starts_from"], True).is_file():
            main([recipe["starts_from"]])
        command = train(recipe)
        print(pack(name, recipe, *folder_of(recipe, ROOT / "runs"), command))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except UserError as error:
        sys.exit(str(error))
