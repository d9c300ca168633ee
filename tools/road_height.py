"""Measure where a depth network puts the road: `python tools/road_height.py any-rig --split test`.

Rigs are four of three Kannala-Brandt fisheyes each, 1.2 m above the road (lenses and directions by seeds 100 to 103),
on eight streets, and with `--drawn` the 24 rigs that the recipe of `any-rig` draws; two frames of each. Only rays
count that a camera sees. A ray is of the road where the true surface is at most 5 cm above or below the height that the
rig states: the car of the virtual world sways, heaves and stands on slopes, so that these are the rays that a flat
road explains.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from unseen_rigs import PIXELS, data_of, overrides_of

from omniocc.camera import Rig
from omniocc.data import OccupancyData
from omniocc.data.dataset import read_images
from omniocc.data.labels.counts import all_frames
from omniocc.errors import UserError
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.depth_map import DepthMap, from_index
from omniocc.model.ops.depth.layers import window_argmax
from omniocc.predict import load
from omniocc.predict.road import flat_road_m, pulled_to_road
from omniocc.runs.script import quiet_libraries
from omniocc.runs.table import markdown
from omniworld.drawn import rig_at, ring_places

SEEDS = (100, 101, 102, 103)
HEIGHT_M = 1.2
DRAWN = (
    "stage=depth",
    "preset=tiny",
    "data.source.rig=random",
    "data.source.weather=in_turn",
    "data.source.themes=[downtown,suburb,industrial,countryside,oldtown,arterial,campus,roundabout,solids,solids]",
    "data.source.repainted_fraction=0.3",
    "data.source.lidars=1",
    "data.source.frame_interval_s=1.0",
    "data.source.frames_per_scene=2",
    "data.source.train_scenes=0",
    "data.source.val_scenes=24",
    "data.source.test_scenes=24",
)
ROAD_M = 0.05
"""Height above or below the stated road up to which a true surface is the road."""
EDGES_M = (0.0, 4.0, 8.5, 12.0, 17.0, 25.6)
BANDS_M = (0.0, 8.5, 17.0, 25.6, 100.0)
WITHIN = (0.25, 0.5, 1.0)
TOLD = 0.8
"""Factor of the height that the network is told to see how far it follows."""


class Frame(NamedTuple):
    """The rays of a frame that a camera sees: true ranges (inf: sky), those of a flat road, predicted ones by name."""

    true_m: Float[Tensor, " R"]
    flat_m: Float[Tensor, " R"]
    road: Bool[Tensor, " R"]
    distance_m: Float[Tensor, " R"]
    spheres: Spheres
    predicted_m: dict[str, Float[Tensor, " R"]]


def three_fisheyes(seed: int) -> Rig:
    """Return a rig of three Kannala-Brandt cameras in a ring of .6 m."""
    rng = np.random.default_rng(seed)
    return rig_at(rng, ring_places(rng, 3, 0.6), "kannala_brandt", PIXELS, -HEIGHT_M)


def read_outs(logits: Float[Tensor, "1 D h w"], spheres: Spheres, window: int) -> dict[str, Float[Tensor, "1 h w"]]:
    """Return indices that a distribution over spheres can be read as, the network's own first."""
    probability = logits.softmax(1)
    places = torch.arange(spheres.count).view(1, -1, 1, 1).float()
    summed = probability.cumsum(1)
    middle = (summed >= 0.5).float().argmax(1, keepdim=True)
    here = probability.gather(1, middle)
    before = summed.gather(1, middle) - here
    log_m = (probability * spheres.range_m(places).log()).sum(1)
    return {
        "as it is": window_argmax(logits, window)[0],
        "peak": window_argmax(logits, 0)[0],
        "window of 8": window_argmax(logits, 8)[0],
        "mean inverse range": (probability * places).sum(1),
        "median": (middle - 0.5 + (0.5 - before) / here)[:, 0],
        "mean log range": spheres.index(log_m.exp()),
    }


def indices(model: Any, images: Tensor, rig: Rig) -> dict[str, DepthMap]:
    """Return depth by read-out, drawn to the road, and with another height told."""
    spheres = model.rig_spheres(rig)
    logits, seen = model.logits(images, rig)
    found = {
        name: from_index(index, seen, seen.float(), spheres)
        for name, index in read_outs(logits[:, :-1].float(), spheres, model.window).items()
    }
    road_z_m = cast(float, rig.road_z_m)
    flat_m = flat_road_m(model.panorama, road_z_m)
    for within in WITHIN:
        found[f"drawn to the road within {within:g}"] = pulled_to_road(found["as it is"], spheres, flat_m, within)
    other = replace(rig, road_z_m=TOLD * road_z_m)
    index, _ = window_argmax(model.logits(images, other)[0][:, :-1], model.window)
    found["told"] = from_index(index, seen, seen.float(), model.rig_spheres(other))
    return found


def frames_of(model: Any, data: OccupancyData, split: Any) -> Iterator[Frame]:
    """Return the frames of a split, with what the network predicts."""
    rays = model.panorama.rays()
    level = (1 - rays[..., 2] ** 2).sqrt()
    for scene, frame in all_frames(data.source.scenes(split)):
        rig, images = scene.rigs[frame], read_images(scene, frame).unsqueeze(0)
        true_m = torch.from_numpy(cast(np.ndarray, scene.erp_range_m(frame))).float()
        far_m = torch.where(true_m.isfinite(), true_m, 1e3).unsqueeze(-1)
        seen = rig.project(rays * far_m)[1].any(0) & ~true_m.isnan()
        flat_m = flat_road_m(model.panorama, cast(float, rig.road_z_m))
        road = (true_m * rays[..., 2] - cast(float, rig.road_z_m)).abs() < ROAD_M
        with torch.inference_mode():
            found = indices(model, images, rig)
        predicted_m = {name: depth.range_m[0][seen] for name, depth in found.items()}
        spheres = model.rig_spheres(rig)
        yield Frame(true_m[seen], flat_m[seen], road[seen], (flat_m * level)[seen], spheres, predicted_m)


def _mean(values: Tensor) -> str:
    return f"{float(values.float().mean()):.2f}"


def _median(values: Tensor) -> str:
    return f"{float(values.median()):.3f}" if len(values) else "-"


def reasons(frames: Sequence[Frame]) -> str:
    """Return, by distance of a flat road, what is there, how the network errs and how it follows the height told."""
    head = ["a flat road is at, m", "rays", "of the road", "things nearer", "farther", "step of spheres, m"]
    head += ["predicted / true: road", "nearer things", "all", "follows the height told by"]
    parts = [(frame.true_m, frame.flat_m, frame.road, frame.distance_m) for frame in frames]
    true_m, flat_m, road, distance_m = (torch.cat(part) for part in zip(*parts, strict=True))
    own_m, told_m = (torch.cat([frame.predicted_m[name] for frame in frames]) for name in ("as it is", "told"))
    step_m = torch.cat([frame.flat_m**2 * frame.spheres.step_per_m for frame in frames])
    ratio, nearer = own_m / true_m, true_m < 0.9 * flat_m
    rows = []
    for low_m, high_m in pairwise(EDGES_M):
        band = (distance_m > low_m) & (distance_m <= high_m)
        follows = (told_m / own_m)[band & road].log() / float(np.log(TOLD))
        shares = [_mean(part[band]) for part in (road, nearer, true_m > 1.1 * flat_m)]
        ratios = [_median(ratio[band & part]) for part in (road, nearer, true_m.isfinite())]
        name = f"{low_m:g}-{high_m:g}"
        rows.append([name, str(int(band.sum())), *shares, f"{float(step_m[band].median()):.2g}", *ratios])
        rows[-1].append(_median(follows))
    return markdown(head, rows)


def errors(frames: Sequence[Frame]) -> str:
    """Return, by way of reading, errors of all surfaces by true range and the road's median ratio by distance."""
    bands = [f"{low:g}-{high:g} m" for low, high in pairwise(BANDS_M)]
    near = [f"road, {low:g}-{high:g} m" for low, high in pairwise(EDGES_M)]
    rows = []
    for name in (name for name in frames[0].predicted_m if name != "told"):
        wrong, true_m, ratio, distance_m = [], [], [], []
        for frame in frames:
            nearest_m = frame.spheres.min_range_m
            found_m = frame.predicted_m[name].clamp(nearest_m, BANDS_M[-1])
            scored = (frame.true_m >= nearest_m) & (frame.true_m <= BANDS_M[-1])
            wrong.append((found_m - frame.true_m).abs()[scored])
            true_m.append(frame.true_m[scored])
            ratio.append((found_m / frame.true_m)[frame.road])
            distance_m.append(frame.distance_m[frame.road])
        w, t, r, d = (torch.cat(part) for part in (wrong, true_m, ratio, distance_m))
        maes = [_mean(w[(t > low) & (t <= high)]) for low, high in pairwise(BANDS_M)]
        roads = [_median(r[(d > low) & (d <= high)]) for low, high in pairwise(EDGES_M)]
        rows.append([name, _mean(w), *maes, *roads])
    return markdown(["", "MAE, m", *bands, *near], rows)


def main(checkpoint: str, split: str, drawn: bool, output: Path) -> None:
    """Print the tables of each rig, then of all of them."""
    quiet_libraries()
    model: nn.Module = load(checkpoint).depth
    if drawn:
        groups = {"drawn rigs": data_of(list(DRAWN))}
    else:
        groups = {}
        for seed in SEEDS:
            file, rig = output / f"three_fisheyes_{seed}.yaml", three_fisheyes(seed)
            rig.save(file)
            groups[f"seed {seed}"] = data_of(overrides_of(file, rig, (0, 8, 8), 2))
    every = []
    for name, data in groups.items():
        every.append(list(frames_of(model, data, split)))
        print(f"\n{name}\n\n{errors(every[-1])}", flush=True)
    together = [frame for frames in every for frame in frames]
    print(f"\nall\n\n{reasons(together)}\n\n{errors(together)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, or name of weights that come with the package")
    parser.add_argument("--split", choices=("val", "test"), default="val", help="scenes; choices are made on val")
    parser.add_argument("--drawn", action="store_true", help="drawn rigs instead of the three fisheyes")
    parser.add_argument("--output", type=Path, default=Path("runs/road_height"), help="folder of the rigs")
    given = parser.parse_args()
    try:
        main(given.checkpoint, given.split, given.drawn, given.output)
    except (UserError, FileNotFoundError) as error:
        sys.exit(str(error))
