"""Finished runs as `train.py` leaves them, without training, and the script that reports over them."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import torch
import yaml

from omniocc.classes import FREE, WORLD_CLASSES
from omniocc.draw import SheetParts, comparison_parts, comparison_sheet, save_png
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.runs.folder import PAGE
from omniocc.runs.results import CANDIDATES, save_results

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))
from fake_scene import HEIGHT, WIDTH, FakeWorld

CYLINDER = {"_target_": "omniocc.geometry.Cylinder", "shape": [8, 10, 4]}
CUBOID = {"_target_": "omniocc.geometry.Cuboid", "shape": [8, 8, 4]}
OMNI = {"_target_": "omniocc.model.sketch.Omni"}
DENSE = {"_target_": "omniocc.model.sketch.Dense"}
SHEET = "test-00-test-000-suburb-000001"
ROOT = Path(__file__).parents[2]


def parts(geometry: Grid, prediction_seed: int) -> SheetParts:
    truth, prediction = (labels(geometry, seed) for seed in (0, prediction_seed))
    images = np.random.default_rng(3).integers(0, 256, (6, 18, 32, 3), dtype=np.uint8)
    return comparison_parts(images, truth, prediction, geometry, WORLD_CLASSES)


def save_parts(folder: Path, parts: SheetParts) -> None:
    """Save a sheet and its parts as `omniocc.train.images` does."""
    (folder / "parts" / SHEET).mkdir(parents=True)
    save_png(folder / f"{SHEET}.png", comparison_sheet(parts, WORLD_CLASSES, "test-000-suburb/000001"))
    for name, part in parts._asdict().items():
        save_png(folder / "parts" / SHEET / f"{name}.png", part)


def labels(geometry: Grid, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 12, geometry.shape, generator=generator, dtype=torch.uint8)


def figures(rayiou: float, surface_rayiou: float | None = None) -> dict[str, float]:
    surface = rayiou / 2 if surface_rayiou is None else surface_rayiou
    classes = {f"test/rayiou/{entry.name}": rayiou / entry.id for entry in WORLD_CLASSES.rows if entry.id != FREE}
    bands = {"test/rayiou_0-8.5m": rayiou, "test/rayiou_8.5-17m": rayiou / 2, "test/rayiou_17-25.6m": rayiou / 4}
    return {"test/rayiou": rayiou, "test/lidar/rayiou": surface, "test/voxel/miou": 0.1} | classes | bands


def write_run(
    folder: Path,
    seed: int,
    rayiou: float,
    world: FakeWorld,
    sketch: dict,
    geometry: dict,
    steps: int = 40,
    surface_rayiou: float | None = None,
) -> None:
    (folder / "csv" / "version_0").mkdir(parents=True)
    described = {
        "_target_": "omniworld.VirtualWorld",
        "root": world.root,
        "rig": "fisheye6",
        "image_size": [WIDTH, HEIGHT],
        "themes": ["downtown", "suburb"],
        "train_scenes": 2,
        "val_scenes": 1,
        "test_scenes": 1,
        "frames_per_scene": 4,
        "frame_interval_s": 0.5,
        "supersample": 1,
        "erp_size": [16, 8],
        "erp_top_deg": 45.0,
        "erp_bottom_deg": -45.0,
    }
    config = {"model": {"geometry": geometry, "sketch": sketch}, "data": {"seed": seed, "source": described}, "lr": 0.1}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    lines = ["step,train/loss,val/rayiou", *(f"{step},{9 - step / 10}," for step in range(0, 40, 10)), f"39,,{rayiou}"]
    (folder / "csv" / "version_0" / "metrics.csv").write_text("\n".join(lines) + "\n")
    metrics = figures(rayiou, surface_rayiou) | (
        {"test/sketch/fraction": 0.25, "test/depth/mae": 2.0} if sketch == OMNI else {}
    )
    facts = {"run": folder.name, "seed": seed, "steps": steps, "preset": "tiny", "minutes of training": 1.5}
    facts |= {"classes": [{"name": entry.name, "rgb": entry.rgb} for entry in WORLD_CLASSES.rows if entry.id != FREE]}
    facts |= {"stages": {"depth": 8, "sketch": 5, "occupancy": steps} if sketch == OMNI else {"occupancy": steps}}
    facts |= {CANDIDATES: 1.0} if sketch == DENSE else {}
    origins = "the ego origin" if geometry == CYLINDER else "given origins"
    facts |= {"protocol": {"rayiou": f"rays from {origins}", "lidar/rayiou": "rays of a LiDAR", "voxel": "all cells"}}
    command = f"python src/train.py '+ablation={folder.name}' seed={seed} <&>"
    save_results(folder, metrics, facts | {"command": command, "commit": "abc", "data": world.fingerprint})


def write_sweep(root: Path) -> Path:
    """Rows ours (two seeds), dense, cuboid (no pictures of another frame), and a run of no table; returns `runs`."""
    world, runs = FakeWorld(str(root / "data")), root / "runs"
    world.prepare()
    rows = [
        ("ours-00000001", 0, 0.30, OMNI, CYLINDER),
        ("ours-00000002", 1, 0.34, OMNI, CYLINDER),
        ("dense-00000001", 0, 0.20, DENSE, CYLINDER),
        ("cuboid-00000001", 0, 0.10, OMNI, CUBOID),
        ("my <own>-00000001", 0, 0.25, OMNI, CYLINDER),
    ]
    drawn = [parts(Cylinder(shape=(8, 10, 4)), 1), parts(Cuboid(shape=(8, 8, 4)), 1)]
    for name, seed, rayiou, sketch, geometry in rows:
        write_run(runs / name, seed, rayiou, world, sketch, geometry)
        save_parts(runs / name / "images", drawn[geometry is CUBOID])
    for name in ("ours-00000001", "my <own>-00000001"):
        (runs / name / PAGE).write_text("a page of view.py")
    return runs


def report(*arguments: str) -> None:
    """Run `src/report.py`."""
    spec = importlib.util.spec_from_file_location("report_script", ROOT / "src" / "report.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.main(list(arguments))
