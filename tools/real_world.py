"""Score checkpoints on real frames: `python tools/real_world.py FOLDER... --checkpoints any-rig tiny`.

The protocol and the figures are in `docs/real_frames.md`, what a FOLDER holds in `tools/real_frames.py`.
"""

import argparse
import cmath
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import torch
from jaxtyping import Bool, Complex128, Float, Float64, UInt8
from real_frames import RealFrame, as_world, foot_points, on_cloth, read_folder
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import UNKNOWN, WORLD_CLASSES
from omniocc.geometry import Cuboid, Cylinder
from omniocc.io import atomic_write
from omniocc.model.protocols import learns
from omniocc.predict import PredictedVoxels, Trained, load
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.output.voxel_files import raise_grid
from omniocc.predict.predictor import predict_depth, seen_cells
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries
from omniocc.runs.table import markdown, number
from omniocc.train import OccupancyTask
from rayiou import RayIoU, RayTruth, VoxelIoU

ALWAYS = "any-rig"
"""The checkpoint beside every other; its ranges are also scored without a network that decides on voxels."""
EDGES_M = (0.0, 8.5, 17.0, 25.6)
BANDS = {f"{low:g}-{high:g} m": (low, high) for low, high in pairwise(EDGES_M)}
WITHIN_M = 2.0
OTHER = WORLD_CLASSES.names.index("Other")
ROAD, BUILDING = WORLD_CLASSES.names.index("Road"), WORLD_CLASSES.names.index("Building")
THING_M, THING_Z_M, TURNS_DEG = 0.9, (0.5, 2.2), range(10, 360, 10)
"""A thing is found where a cell so near to its foot point, so high above the road, is occupied; turns for chance."""
VOXEL_HEAD = ("RayIoU", "without classes", "road", "standing", *BANDS, "IoU")
CLOTH_HEAD = ("cloth occupied", "of it Road", "standing on it", "things", "by chance")
RANGE_HEAD = ("points", "with an answer", "within 10 %", "within 25 %", "median error")


def road_layer(grid: Cylinder | Cuboid, road_z_m: float) -> int:
    """Return the place along z of the cells that hold the road; below 0 or above the last where no cells do."""
    return math.floor((road_z_m - grid.height_m[0]) / grid.cell_m[2])


def ruled(occupied: Bool[Tensor, "X Y Z"], road: int) -> UInt8[Tensor, "X Y Z"]:
    """Return classes by height alone: Road up to the layer of the road, Building above."""
    by_height = torch.where(torch.arange(occupied.shape[2]) <= road, ROAD, BUILDING)
    return torch.where(occupied, by_height, 0).to(torch.uint8)


def ranges(trained: Trained, frame: RealFrame, rig: Rig) -> tuple[Float[Tensor, "h w"], Equirectangular]:
    """Return the ranges around a rig by the depth network of a checkpoint, nan without an answer, and its panorama."""
    batch, scaled = resized_to_width(frame.images, rig, trained.facts.width_for(rig))
    depth = predict_depth(trained.depth, batch, scaled, torch.device("cpu"))
    return depth.known_range_m()[0], cast(Equirectangular, trained.depth.panorama)


def range_cells(trained: Trained, frame: RealFrame, grid: Cylinder | Cuboid) -> UInt8[Tensor, "X Y Z"]:
    """Return the cells that the ranges end in, by `ruled`; the origin is as high above the road as in training."""
    rig, raised_m, _ = trained.facts.place(frame.rig)
    range_m, panorama = ranges(trained, frame, rig)
    known = range_m.isfinite()
    points_m = panorama.rays()[known] * range_m[known, None] + torch.tensor([0.0, 0.0, raised_m])
    occupied = grid.voxelize(points_m, torch.ones(len(points_m), dtype=torch.uint8), 2) > 0
    return ruled(occupied, road_layer(grid, frame.road_z_m))


def looked_up(range_m: Float[Tensor, "h w"], panorama: Equirectangular, points_m: Tensor) -> Float64[Tensor, " P"]:
    """Return the range in the direction of each point, nan where the panorama has none."""
    pixels, valid = panorama.project(points_m)
    column, row = pixels.round().long().unbind(-1)
    return range_m[row.clamp(0, panorama.height - 1), column % panorama.width].where(valid, torch.nan).double()


def range_scores(range_m: Float64[Tensor, " P"], frame: RealFrame) -> dict[str, list[float]]:
    """Return by kind of point: number, fractions answered, within 10 and 25 %, and the median relative error."""
    true_m = frame.points_m.norm(dim=-1)
    error = ((range_m - true_m) / true_m).abs()
    kinds = {"road": ~frame.standing, "standing": frame.standing}
    kinds |= {band: (true_m > low) & (true_m <= high) for band, (low, high) in BANDS.items()}
    scores = {}
    for kind, part in ((kind, error[chosen]) for kind, chosen in kinds.items() if bool(chosen.any())):
        fractions = [float(one.double().mean()) for one in (part.isfinite(), part < 0.1, part < 0.25)]
        scores[kind] = [len(part), *fractions, float(part.nanmedian())]
    return scores


def ray_scores(
    labels: UInt8[Tensor, "X Y Z"], grid: Cylinder | Cuboid, frame: RealFrame, seen: Bool[Tensor, "X Y Z"]
) -> dict[str, float]:
    """Return the scores of voxels (0 free) by the rays of the LiDAR; see `docs/real_frames.md`."""
    lidar_m = cast(Tensor, frame.lidar_m)
    near = (frame.points_m - lidar_m).norm(dim=-1) <= EDGES_M[-1]
    points_m, standing = frame.points_m[near], frame.standing[near]
    range_m = (points_m - lidar_m).norm(dim=-1)
    directions, starts = (points_m - lidar_m) / range_m[:, None], lidar_m.expand_as(points_m)
    occupied, hit = (labels > 0).to(torch.uint8), torch.ones(len(range_m), dtype=torch.uint8)

    def by_rays(volume: Tensor, truth: Tensor, classes: int = 2) -> RayIoU:
        metric = RayIoU(grid, classes, range_edges_m=EDGES_M)
        metric.update(volume[None], RayTruth(range_m[None], truth[None], directions[None], starts[None]))
        return metric

    def right(metric: RayIoU) -> Float64[Tensor, "2 bands"]:
        place = metric.counter.thresholds_m.index(WITHIN_M)
        return torch.stack([metric.correct[:, place, 1], metric.truth[:, 1]]).double()

    whole, scores = by_rays(occupied, hit), {}
    if frame.labels is not None:
        classes = by_rays(labels, frame.labels[near], WORLD_CLASSES.num_classes).compute()
        scores = {name: float(value) for name, value in classes.items() if name.startswith("rayiou/")}
        scores["RayIoU"] = float(classes["rayiou"])
    scores["without classes"] = float(whole.compute()["rayiou"])
    for kind, others in (("road", standing), ("standing", ~standing)):
        correct, count = right(by_rays(occupied, hit.masked_fill(others, UNKNOWN))).sum(1)
        scores[kind] = float(correct / count)
    correct, count = right(whole)
    scores |= dict(zip(BANDS, (correct / count).tolist(), strict=False)) | {"rays": int(count.sum())}
    paths = grid.paths(starts, directions)
    crossed = paths.cells[(paths.cells >= 0) & (paths.exit_m <= range_m[:, None])].long()
    target = grid.voxelize(points_m, hit, 2)
    observed = (target > 0) | torch.zeros(grid.num_cells).index_fill(0, crossed, 1.0).reshape(grid.shape).bool()
    metric = VoxelIoU(2)
    metric.update(occupied[None], target[None], (observed & seen)[None])
    return scores | {"IoU": float(metric.compute()["iou"])}


def things_found(cells: Complex128[Tensor, " C"], feet: Complex128[Tensor, " F"]) -> int:
    """Return how many foot points have the centre of one of these cells within `THING_M`; both are x + iy, m."""
    return int(((cells - feet[:, None]).abs() <= THING_M).any(1).sum())


def cloth_scores(
    labels: UInt8[Tensor, "X Y Z"], grid: Cylinder | Cuboid, frame: RealFrame, seen: Bool[Tensor, "X Y Z"]
) -> dict[str, float]:
    """Return the scores of voxels (0 free) by cloth and things; see `docs/real_frames.md`."""
    centers, road = grid.centers(torch.float64), road_layer(grid, frame.road_z_m)
    columns = labels[on_cloth(centers[:, :, road]) & seen[:, :, road]]
    covered = columns[:, road] > 0
    high_m = (centers[..., 2] - frame.road_z_m).round(decimals=6)
    body = (labels > 0) & (high_m >= THING_Z_M[0]) & (high_m <= THING_Z_M[1])
    cells, feet = (torch.complex(xyz[:, 0], xyz[:, 1]) for xyz in (centers[body], foot_points(frame.rig)))
    chance = [things_found(cells, feet * cmath.rect(1, math.radians(angle))) for angle in TURNS_DEG]
    return {
        "cloth occupied": float(covered.double().mean()),
        "of it Road": float((columns[covered, road] == ROAD).double().mean()),
        "standing on it": float((columns[:, road + 1 :] > 0).any(1).double().mean()),
        "things": things_found(cells, feet),
        "by chance": sum(chance) / len(chance),
    }


def voxel_rows(frame: RealFrame, checkpoints: Mapping[str, Trained], geometry: Any) -> dict[str, dict[str, float]]:
    """Return the scores of the checkpoints whose grid is `geometry`, and of what stands beside them, by row."""
    voxels = {name: one for name, one in checkpoints.items() if one.stage == OccupancyTask.STAGE}
    mine = {name: one for name, one in voxels.items() if one.occupancy.geometry == geometry}
    grid = raise_grid(geometry, next(iter(mine.values())).facts.place(frame.rig)[1])
    assert isinstance(grid, Cylinder | Cuboid)
    eye, road = torch.eye(4, dtype=torch.float64), road_layer(grid, frame.road_z_m)
    seen = seen_cells(grid, [(frame.rig, eye)], eye)
    rows = {"a flat road": ruled((torch.arange(grid.shape[2]) == road).expand(grid.shape), road)}
    for name, one in checkpoints.items():
        if name == ALWAYS or name not in voxels:
            rows[f"ranges of {name} as cells"] = range_cells(one, frame, grid)
    for name, one in mine.items():
        found = cast(PredictedVoxels, one.predict(frame.images, frame.rig))
        rows[name] = as_world(found.names, found.labels)
    if frame.lidar_m is not None:
        labels = torch.full((len(frame.points_m),), OTHER, dtype=torch.uint8) if frame.labels is None else frame.labels
        rows["true voxels"] = grid.voxelize(frame.points_m, labels)
    score = cloth_scores if frame.lidar_m is None else ray_scores
    kept = {name: labels.masked_fill(~seen | (labels == UNKNOWN), 0) for name, labels in rows.items()}
    return {name: score(labels, grid, frame, seen) for name, labels in kept.items()}


def range_rows(frame: RealFrame, checkpoints: Mapping[str, Trained]) -> dict[str, dict[str, list[float]]]:
    """Return the scores of a flat road and of the depth networks, told the height of the road and not, by row."""
    down = frame.points_m[:, 2]
    flat_m = frame.points_m.norm(dim=-1) * frame.road_z_m / down.where(down < 0, torch.nan)
    rows = {"a flat road": range_scores(flat_m, frame)}
    for name, one in checkpoints.items():
        if one.stage == OccupancyTask.STAGE and not learns(type(one.occupancy.sketch)):
            continue  # it has no ranges
        told = {name: frame.rig}
        if getattr(one.depth, "hints", False):
            told[f"{name}, not told the height"] = replace(frame.rig, road_z_m=None)
        for row, rig in told.items():
            rows[row] = range_scores(looked_up(*ranges(one, frame, rig), frame.points_m), frame)
    return rows


def voxel_table(rows: Mapping[str, Mapping[str, float]]) -> str:
    """Return a table of the scores of voxels."""
    head = CLOTH_HEAD if "things" in next(iter(rows.values())) else VOXEL_HEAD
    cells = [
        [name, *(f"{s[key]:.3g}" if s.get(key, 0) > 1 else number(s.get(key)) for key in head)]
        for name, s in rows.items()
    ]
    return markdown(["voxels", *head], cells)


def range_table(rows: Mapping[str, Mapping[str, list[float]]]) -> str:
    """Return a table of the scores of ranges."""
    cells = [
        [name, kind, str(count), *(f"{value:.0%}" for value in values)]
        for name, kinds in rows.items()
        for kind, (count, *values) in kinds.items()
    ]
    return markdown(["ranges", "of", *RANGE_HEAD], cells)


@lines_not_tracebacks
def main(words: list[str] | None = None) -> None:
    """Print tables for every frame in the folders, each frame alone."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="of samples")
    parser.add_argument("--checkpoints", nargs="+", default=[], help="files, or names of weights in the package")
    parser.add_argument("--write", type=Path, metavar="FILE.json", help="keep the figures")
    given = parser.parse_args(words)
    quiet_libraries()
    frames, figures = [frame for folder in given.folders for frame in read_folder(folder)], {}
    checkpoints = {name: load(name) for name in dict.fromkeys([ALWAYS, *given.checkpoints])}
    grids = dict.fromkeys(one.occupancy.geometry for one in checkpoints.values() if one.stage == OccupancyTask.STAGE)
    for frame in frames:
        voxels, depths = [voxel_rows(frame, checkpoints, grid) for grid in grids], range_rows(frame, checkpoints)
        figures[frame.name] = {"voxels": voxels, "ranges": depths}
        print("\n".join([f"### {frame.name}\n", *map(voxel_table, voxels), range_table(depths)]), flush=True)
    if given.write:
        atomic_write(given.write, json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
