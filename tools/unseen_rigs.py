"""Score a depth network on twelve rigs that training never draws: `python tools/unseen_rigs.py any-rig`.

Each has a lens, a height, a number of cameras or a radius that `omniworld.drawn` leaves out. `--own 3` also trains
a network for each of the rigs in `OWN`, 800 steps on that rig alone, and scores it beside the other.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Float
from make_weights import folder_of, train
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.data import OccupancyData
from omniocc.data.dataset import read_images
from omniocc.data.labels.counts import all_frames
from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.metric import CalibrationError, DepthMetrics
from omniocc.model.depth import DepthMap
from omniocc.parts import Parts
from omniocc.predict import load
from omniocc.progress import Progress
from omniocc.runs.script import quiet_libraries, train_config
from omniocc.train.depth import FARTHEST_M, score_confidence
from omniworld.drawn import car_places, rig_at, ring_places

ROOT = Path(__file__).parents[1]
PIXELS = 256 * 144
BANDS = ("_0-8.5m", "_8.5-17m", "_17-25.6m")
OWN_STEPS = 800


class Unseen(NamedTuple):
    """What makes a rig: cameras (0: those of a car), radius of their ring, m, lens, and height above the road, m."""

    count: int
    radius_m: float
    lens: str
    height_m: float


UNSEEN = {
    "ocam_ring4": Unseen(4, 0.6, "ocam", 1.5),
    "ocam_ring6": Unseen(6, 1.2, "ocam", 1.8),
    "ocam_car": Unseen(0, 0.0, "ocam", 0.9),
    "ocam_pair": Unseen(2, 0.15, "ocam", 1.0),
    "low_ring5": Unseen(5, 0.3, "kannala_brandt", 0.35),
    "low_ring3": Unseen(3, 0.2, "double_sphere", 0.3),
    "high_ring6": Unseen(6, 1.4, "eucm", 3.0),
    "high_ring4": Unseen(4, 1.0, "mei", 3.4),
    "ring9": Unseen(9, 0.8, "radial_polynomial", 1.5),
    "ring10": Unseen(10, 1.5, "equidistant", 2.0),
    "wide_ring6": Unseen(6, 2.2, "kannala_brandt", 2.2),
    "ocam_high_ring9": Unseen(9, 2.0, "ocam", 3.0),
}
"""The rigs; some are unseen in more than one way."""
OWN = ("ocam_ring4", "low_ring5", "wide_ring6")
"""Those for which a network of their own is trained."""


def unseen_rig(name: str) -> Rig:
    """Return a rig of `UNSEEN`."""
    row, rng = UNSEEN[name], np.random.default_rng(list(UNSEEN).index(name))
    places = ring_places(rng, row.count, row.radius_m) if row.count else car_places(rng)
    return rig_at(rng, places, row.lens, PIXELS, -row.height_m)


def overrides_of(file: Path, rig: Rig, scenes: tuple[int, int, int], frames: int) -> list[str]:
    """Return overrides of `conf/train.yaml` for scenes of a rig."""
    camera, (train_scenes, val_scenes, test_scenes) = rig.cameras[0], scenes
    return [
        "stage=depth",
        "preset=tiny",
        f"data.source.rig={file}",
        f"data.source.frames_per_scene={frames}",
        f"data.source.image_size=[{camera.width},{camera.height}]",
        f"data.source.train_scenes={train_scenes}",
        f"data.source.val_scenes={val_scenes}",
        f"data.source.test_scenes={test_scenes}",
        "data.source.lidars=1",
    ]


class Scores:
    """Errors, calibration and answers of a network on the frames of one rig."""

    def __init__(self, nearest_m: float, edges_m: tuple[float, ...]):
        self.errors = DepthMetrics(nearest_m, FARTHEST_M, range_edges_m=edges_m)
        self.by_cameras = {"one camera": CalibrationError(), "several": CalibrationError()}
        self.answered, self.asked = 0, 0

    def update(self, depth: DepthMap, true_range_m: Float[Tensor, "1 h w"], cameras: Tensor) -> None:
        """Add a frame; `cameras` (h, w) is how many cameras see the true point of a direction."""
        seen = (cameras > 0).unsqueeze(0) & true_range_m.isfinite()
        self.errors.update(depth.range_m, true_range_m, seen)
        for metric, chosen in zip(self.by_cameras.values(), (cameras == 1, cameras > 1), strict=True):
            rows = score_confidence(depth._replace(valid=depth.valid & chosen), true_range_m)
            metric.update(rows[:, 0], rows[:, 2] > 0)
        self.answered += int((depth.valid & seen).sum())
        self.asked += int(seen.sum())

    def compute(self) -> dict[str, float]:
        """Return MAE by band, calibration error by cameras, fraction of the seen surfaces with an answer."""
        errors = self.errors.compute()
        values = {f"mae{band}": float(errors[f"mae{band}"]) for band in ("", *BANDS)}
        for name, metric in self.by_cameras.items():
            scores = metric.compute()
            values |= {f"ece, {name}": float(scores["ece"]), f"right, {name}": float(scores["right"])}
        return values | {"answered": self.answered / max(1, self.asked)}


def score(model: nn.Module, data: OccupancyData, without: int | None = None) -> dict[str, float]:
    """Return the scores of a network on the test frames of a rig, or without one of its cameras."""
    panorama, edges_m = cast(Equirectangular, model.panorama), data.source.spec.range_edges_m
    rays, scores = panorama.rays(), None
    for scene, frame in all_frames(data.source.scenes("test")):
        rig, images = scene.rigs[frame], read_images(scene, frame).unsqueeze(0)
        seen_by = range(len(rig.cameras))
        if without is not None:
            images[:, without] = 0
            seen_by = [camera for camera in seen_by if camera != without]
        true_m = torch.from_numpy(cast(np.ndarray, scene.erp_range_m(frame))).float()
        far_m = torch.where(true_m.isfinite(), true_m, 1e3).unsqueeze(-1)
        cameras = rig.project(rays * far_m)[1][list(seen_by)].sum(0)
        with torch.inference_mode():
            depth = model(images, (rig,))
        scores = scores or Scores(cast(Any, model).rig_spheres(rig).min_range_m, edges_m)
        scores.update(depth, true_m.unsqueeze(0), cameras)
    assert scores is not None
    return scores.compute()


def data_of(overrides: list[str]) -> OccupancyData:
    """Return the data of a configuration, rendered."""
    data = Parts(train_config(overrides)).data()
    data.prepare_data()
    return data


def own_network(name: str, file: Path) -> nn.Module:
    """Return a network trained for one rig alone, after training it if it is missing."""
    overrides = overrides_of(file, unseen_rig(name), (240, 8, 8), 2)
    recipe = {"stage": "depth", "overrides": [*overrides, f"preset.stages.depth.max_steps={OWN_STEPS}"]}
    train(recipe)
    folder, checkpoint = folder_of(recipe, ROOT / "runs")
    return load(folder / checkpoint).depth


def table(rows: dict[str, dict[str, float]]) -> str:
    """Return the scores as a Markdown table, with the mean over the rigs of the network under test."""
    keys = list(next(iter(rows.values())))
    mean = {key: float(np.nanmean([row[key] for name, row in rows.items() if "(own)" not in name])) for key in keys}
    lines = ["| rig | " + " | ".join(key.replace("_", ", ") for key in keys) + " |", "|---|" + "---:|" * len(keys)]
    for name, row in {**rows, "mean": mean}.items():
        lines.append(f"| {name} | " + " | ".join(f"{row[key]:.2f}" for key in keys) + " |")
    return "\n".join(lines)


def main(checkpoint: str, own: int, output: Path) -> None:
    """Score a checkpoint on all rigs and write the scores as JSON; print the table."""
    quiet_libraries()
    model, rows = load(checkpoint).depth, {}
    files = {name: output / "rigs" / f"{name}.yaml" for name in UNSEEN}
    with Progress("unseen rigs", len(UNSEEN), "rigs") as progress:
        for name, file in files.items():
            file.parent.mkdir(parents=True, exist_ok=True)
            unseen_rig(name).save(file)
            data = data_of(overrides_of(file, unseen_rig(name), (0, 0, 8), 2))
            rows[name] = score(model, data)
            rows[name]["mae without camera 1"] = score(model, data, 0)["mae"]
            if name in OWN[:own]:
                network = own_network(name, file)
                rows[f"{name} (own)"] = {**score(network, data), "mae without camera 1": score(network, data, 0)["mae"]}
            progress.advance()
            atomic_write(output / "scores.json", json.dumps(rows, indent=2) + "\n")
    print(table(rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, or name of weights that come with the package")
    parser.add_argument("--own", type=int, default=0, choices=range(len(OWN) + 1), help="networks of their own rigs")
    parser.add_argument("--output", type=Path, default=Path("runs/unseen_rigs"), help="folder of rigs and scores")
    given = parser.parse_args()
    try:
        main(given.checkpoint, given.own, given.output)
    except (UserError, FileNotFoundError) as error:
        sys.exit(str(error))
