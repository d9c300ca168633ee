"""Scores split by origin of the rays, and the line that says how scores were counted."""

import pickle
import re

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import RayIoU, RayTruth, VoxelIoU, ray_iou, sparseocc_directions

GRID = Cylinder((16, 20, 6), (0.0, 12.0), (-2.8, 3.2))
LINE = Cuboid((10, 1, 1), (0.0, 10.0), (-0.5, 0.5), (-0.5, 0.5))
DIRECTIONS = sparseocc_directions()[::7]
ORIGINS = torch.tensor([[[-3.0, 1.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.1], [5.0, -1.0, 0.2]]]).repeat(2, 1, 1)
TIMES = torch.tensor([[-2, 0, 1, 5], [-3, -1, 0, 2]])


def frames(seed=0):
    generator = torch.Generator().manual_seed(seed)
    target = torch.randint(1, 12, (2, *GRID.shape), generator=generator, dtype=torch.uint8)
    target[torch.rand(target.shape, generator=generator) < 0.95] = 0
    return torch.where(torch.rand(target.shape, generator=generator) < 0.7, target, target.roll(1, 1)), target


@pytest.mark.parametrize("edges_m", [None, (0.0, 4.0, 9.0)])
def test_scores_of_each_time_are_those_of_its_origins_alone(edges_m):
    preds, target = frames()
    plain, split = (
        RayIoU(GRID, directions=DIRECTIONS, range_edges_m=edges_m, split_origins=on) for on in (False, True)
    )
    plain.update(preds, target, ORIGINS)
    split.update(preds, target, ORIGINS, origin_times=TIMES.float() / 2)  # seconds at two frames a second
    scores = split.compute()
    for key, value in plain.compute().items():
        assert torch.equal(scores[key], value), key
    assert set(scores) - set(plain.compute()) == {"rayiou_past", "rayiou_now", "rayiou_future"}
    for name, sign in (("past", -1), ("now", 0), ("future", 1)):
        alone = RayIoU(GRID, directions=DIRECTIONS)
        for sample in range(2):
            chosen, one = TIMES[sample].sign() == sign, slice(sample, sample + 1)
            alone.update(preds[one], target[one], ORIGINS[sample][chosen][None])
        assert scores[f"rayiou_{name}"] == alone.compute()["rayiou"]
    function = ray_iou(
        preds,
        target,
        GRID,
        ORIGINS,
        directions=DIRECTIONS,
        range_edges_m=edges_m,
        split_origins=True,
        origin_times=TIMES,
    )
    assert all(torch.equal(function[key], value) for key, value in scores.items())


def test_the_ego_origin_and_rays_of_a_lidar_belong_to_the_frame_itself():
    preds, target = frames()
    metric = RayIoU(GRID, directions=DIRECTIONS, split_origins=True)
    metric.update(preds, target)
    ranges, labels = torch.full((2, len(DIRECTIONS)), 5.0), torch.full((2, len(DIRECTIONS)), 4)
    metric.update_rays(preds, ranges, labels)
    metric.update(preds, RayTruth(ranges, labels, DIRECTIONS.float().expand(2, -1, -1)))
    scores = metric.compute()
    assert scores["rayiou_now"] == scores["rayiou"]
    assert scores["rayiou_past"].isnan()
    assert scores["rayiou_future"].isnan()


def test_no_origins_count_nothing():
    preds, target = frames()
    metric = RayIoU(GRID, directions=DIRECTIONS, split_origins=True)
    metric.update(preds, target, torch.zeros(2, 0, 3), origin_times=torch.zeros(2, 0))
    assert metric.truth.sum() == 0


def test_error_names_missing_and_wrong_times():
    preds, target = frames()
    metric = RayIoU(GRID, directions=DIRECTIONS, split_origins=True)
    with pytest.raises(ValueError, match="split_origins needs origin_times"):
        metric.update(preds, target, ORIGINS)
    with pytest.raises(ValueError, match=r"origin_times must be \(2, 4\).*got \(2, 3\)"):
        metric.update(preds, target, ORIGINS, origin_times=TIMES[:, :3])
    with pytest.raises(ValueError, match="origin_times must be None without origins"):
        RayIoU(GRID).update(preds, target, origin_times=TIMES)


def test_plot_by_origin():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    preds, target = frames()
    metric = RayIoU(GRID, directions=DIRECTIONS, split_origins=True, range_edges_m=(0.0, 4.0, 9.0))
    metric.update(preds, target, ORIGINS, origin_times=TIMES)
    _, axes = metric.plot(by="origin")
    assert [bar.get_height() for bar in axes.patches] == pytest.approx(
        [float(metric.compute()[f"rayiou_{name}"]) for name in ("past", "now", "future")]
    )
    assert len(metric.plot(by="range")[1].patches) == 2
    with pytest.raises(ValueError, match="no scores with these keys"):
        RayIoU(GRID).plot(metric.compute(), by="origin")
    matplotlib.pyplot.close("all")


def test_the_line_of_the_default():
    assert RayIoU(GRID).protocol() == (
        "14040 rays (39 elevations x 360 azimuths, as SparseOcc) from the ego origin; "
        "correct: same class, error below 1, 2, 4 m where the ray leaves its cell; "
        "rays count whose truth is not unknown (255) or free; "
        "mean over thresholds and the classes that occur, of 11 without free"
    )


def test_the_line_says_what_was_given():
    preds, target = frames()
    metric = RayIoU(
        GRID, directions=DIRECTIONS, thresholds_m=(0.5, 1), hit="entry", count_free_rays=True, ignore_index=99
    )
    target = target.clamp(max=11)
    metric.update(preds, target)
    assert f"{len(DIRECTIONS)} rays from the ego origin; " in metric.protocol()
    assert "error below 0.5, 1 m where the ray enters its cell; " in metric.protocol()
    assert "truth is not unknown (99); " in metric.protocol()
    metric.update(preds, target, ORIGINS, target > 0)
    assert "from each of at most 4 origins a frame (given origins); " in metric.protocol()
    assert "truth is not unknown (99) or in a cell that is not observed; " in metric.protocol()
    metric.update(preds, target, ORIGINS[:, :1], origin_times=TIMES[:, :1])
    twin = pickle.loads(pickle.dumps(metric))
    assert "4 origins a frame (where the car was in past, present and future frames)" in twin.protocol()
    metric.reset()
    assert "rays from the ego origin; " in metric.protocol()
    assert "not observed" not in metric.protocol()


def test_the_line_of_measured_rays():
    preds, _ = frames()
    ranges, labels = torch.full((2, len(DIRECTIONS)), 5.0), torch.full((2, len(DIRECTIONS)), 4)
    metric = RayIoU(GRID, directions=DIRECTIONS)
    metric.update_rays(preds, ranges, labels)
    assert f"{len(DIRECTIONS)} rays measured by a LiDAR from the ego origin; " in metric.protocol()
    assert "m from the measured point to the predicted cell; " in metric.protocol()
    metric.update(preds, RayTruth(ranges, labels, DIRECTIONS.float().expand(2, -1, -1)))
    assert metric.protocol().startswith("rays measured by a LiDAR, from where it was; ")
    assert metric.protocol().endswith("; rays without a return or with a point outside of the grid are free")


def test_the_line_of_voxels():
    preds, target = frames()
    metric = VoxelIoU()
    metric.update(preds, target)
    known = "cells count whose truth is not unknown (255)"
    mean = "mIoU: mean over the classes that occur, of 11 without free"
    assert metric.protocol() == f"{known}, each once; {mean}"
    metric = VoxelIoU(grid=GRID)
    metric.update(preds, target, target > 0)
    assert metric.protocol() == f"{known} and that are observed, weighed by volume; {mean}"
    metric.reset()
    assert metric.protocol() == f"{known}, weighed by volume; {mean}"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"labels": torch.tensor([[1, 5]])}, "labels must hold class ids 0..2 or 255, got [5]"),
        ({"labels": torch.tensor([[1]])}, "labels must have shape (B, 2), got (1, 1)"),
        ({"labels": torch.tensor([[1, 2], [1, 2]])}, "preds and labels must have the same batch size, got 1 and 2"),
        ({"range_m": torch.ones(1, 3)}, "range_m must have shape (1, 2), got (1, 3)"),
        ({"directions": 2 * torch.eye(3)[None, :2]}, "directions must be unit vectors, got lengths 2 to 2"),
        ({"starts": torch.zeros(1, 3, 3)}, "starts must have shape (1, 2, 3), a vector for each ray, got (1, 3, 3)"),
    ],
)
def test_mistakes_in_the_rays_of_single_frames_are_named(changed, words):
    metric = RayIoU(Cuboid((2, 2, 2), (-2, 2), (-2, 2), (-2, 2)), num_classes=3)
    directions = torch.tensor([[[1.0, 0, 0], [0, 1.0, 0]]])
    right = RayTruth(torch.ones(1, 2), torch.tensor([[1, 2]]), directions, torch.zeros(1, 2, 3))
    preds = torch.ones(1, 2, 2, 2, dtype=torch.uint8)
    metric.update(preds, right)
    padded = directions * torch.tensor([1, 0])[:, None]
    metric.update(preds, right._replace(labels=torch.tensor([[1, 255]]), directions=padded))
    with pytest.raises(ValueError, match=re.escape(words)):
        metric.update(preds, right._replace(**changed))
    with pytest.raises(ValueError, match="observed is for true voxels"):
        metric.update(preds, right, observed=torch.ones(1, 2, 2, 2, dtype=torch.bool))
