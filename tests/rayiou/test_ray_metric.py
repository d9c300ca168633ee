import datetime
import itertools
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import omniocc
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import DepthMetrics, RayIoU, VoxelIoU, ray_iou, sparseocc_directions

CYLINDER = Cylinder(shape=(16, 20, 6), radius_m=(0.0, 12.0), height_m=(-2.8, 3.2))
CUBOID = Cuboid(shape=(16, 14, 6), x_m=(-8.0, 8.0), y_m=(-7.0, 7.0), height_m=(-2.8, 3.2))
LINE = Cuboid(shape=(10, 1, 1), x_m=(0.0, 10.0), y_m=(-0.5, 0.5), height_m=(-0.5, 0.5))
FORWARD = torch.tensor([[1.0, 0.0, 0.0]])


def frames(grid, count, seed=0, num_classes=12):
    generator = torch.Generator().manual_seed(seed)
    target = torch.randint(1, num_classes, (count, *grid.shape), generator=generator, dtype=torch.uint8)
    target[torch.rand(target.shape, generator=generator) < 0.95] = 0
    prediction = torch.where(torch.rand(target.shape, generator=generator) < 0.7, target, target.roll(1, 1))
    target[torch.rand(target.shape, generator=generator) < 0.01] = 255
    return prediction, target


def public_counting(grid, prediction, target, origins, directions, thresholds_m, low_m=0.0, high_m=math.inf):
    """Return IoU or nan by threshold and class, counted ray by ray as in the public script, without unknown truth."""
    gt, pr, tp = np.zeros(12), np.zeros(12), np.zeros((len(thresholds_m), 12))
    for frame in range(len(prediction)):
        for origin in origins[frame]:
            start = origin.expand(len(directions), 3)
            true_m, true_labels = grid.trace(target[frame], start, directions)
            our_m, our_labels = grid.trace(prediction[frame], start, directions)
            for l_gt, l_pr, d_gt, d_pr in zip(
                true_labels.tolist(), our_labels.tolist(), true_m.tolist(), our_m.tolist(), strict=True
            ):
                if l_gt in (0, 255) or not low_m <= d_gt < high_m:
                    continue
                gt[l_gt] += 1
                pr[l_pr] += 1
                for t, threshold_m in enumerate(thresholds_m):
                    if l_gt == l_pr and abs(d_pr - d_gt) < threshold_m:
                        tp[t, l_gt] += 1
    with np.errstate(invalid="ignore"):
        return tp[:, 1:] / (gt + pr - tp)[:, 1:]


@pytest.mark.parametrize("grid", [CYLINDER, CUBOID])
def test_counting_agrees_with_the_public_definition(grid):
    prediction, target = frames(grid, 3)
    directions = sparseocc_directions()[::17]
    origins = torch.tensor([[[0.0, 0.0, 0.0], [1.3, -2.1, 0.4]]]).expand(3, 2, 3)
    edges_m = (0.0, 4.0, 9.0)
    metric = RayIoU(grid, directions=directions, range_edges_m=edges_m, thresholds_m=(0.5, 1, 3))
    for i in range(3):
        metric.update(prediction[i : i + 1], target[i : i + 1], origins[i : i + 1])
    scores = metric.compute()
    iou = public_counting(grid, prediction, target, origins, directions, (0.5, 1, 3))
    assert scores["rayiou"].item() == pytest.approx(np.nanmean(iou), abs=1e-6)
    for t, threshold in enumerate(("0.5", "1", "3")):
        assert scores[f"rayiou@{threshold}"].item() == pytest.approx(np.nanmean(iou[t]), abs=1e-6)
    for c in range(11):
        assert scores[f"rayiou/{c + 1}"].item() == pytest.approx(np.nanmean(iou[:, c]), abs=1e-6)
    for low_m, high_m in itertools.pairwise(edges_m):
        part = public_counting(grid, prediction, target, origins, directions, (0.5, 1, 3), low_m=low_m, high_m=high_m)
        assert scores[f"rayiou_{low_m:g}-{high_m:g}m"].item() == pytest.approx(np.nanmean(part), abs=1e-6)
    assert len(scores) == 1 + 3 + 11 + 2 + 1


@pytest.mark.parametrize("grid", [CYLINDER, CUBOID])
def test_fine_thresholds_are_scored_from_the_same_rays(grid):
    prediction, target = frames(grid, 2)
    directions = sparseocc_directions()[::23]
    origins = torch.zeros(2, 1, 3)
    options = {"directions": directions, "range_edges_m": (0.0, 4.0, 9.0)}
    scores = ray_iou(prediction, target, grid, thresholds_m=(1, 2), fine_thresholds_m=(0.25, 0.5, 1), **options)
    alone = ray_iou(prediction, target, grid, thresholds_m=(1, 2), **options)
    assert {key: value for key, value in scores.items() if not key.startswith("fine/")} == alone
    iou = public_counting(grid, prediction, target, origins, directions, (0.25, 0.5, 1))
    expected = {"fine/rayiou": np.nanmean(iou)}
    expected |= {f"fine/rayiou@{t}": np.nanmean(row) for t, row in zip(("0.25", "0.5", "1"), iou, strict=True)}
    assert {key for key in scores if key.startswith("fine/")} == set(expected)
    for key, value in expected.items():
        assert scores[key].item() == pytest.approx(value, abs=1e-6)
    assert scores["fine/rayiou@1"] == scores["rayiou@1"]
    assert scores["fine/rayiou"] < scores["rayiou"]


def line(**cells):
    labels = torch.zeros(1, 10, 1, 1, dtype=torch.uint8)
    for place, label in cells.items():
        labels[0, int(place[1:])] = label
    return labels


@pytest.mark.parametrize(
    ("prediction", "target", "expected"),
    [
        (line(c3=4), line(c3=4), {"@1": 1.0, "@2": 1.0, "@4": 1.0}),
        (line(c4=4), line(c3=4), {"@1": 0.0, "@2": 1.0, "@4": 1.0}),  # 1 m off: not strictly below 1 m
        (line(c6=4), line(c3=4), {"@1": 0.0, "@2": 0.0, "@4": 1.0}),
        (line(c3=5), line(c3=4), {"@1": 0.0, "@2": 0.0, "@4": 0.0}),
        (line(), line(c3=4), {"@1": 0.0, "@2": 0.0, "@4": 0.0}),
        (line(c3=4), line(), {"@1": None, "@2": None, "@4": None}),  # free truth: a hallucination costs nothing
        (line(c3=4), line(c2=255, c3=4), {"@1": None, "@2": None, "@4": None}),  # first true hit unknown
    ],
)
def test_one_ray_by_hand(prediction, target, expected):
    scores = ray_iou(prediction, target, LINE, directions=FORWARD)
    for key, value in expected.items():
        found = scores[f"rayiou{key}"].item()
        assert math.isnan(found) if value is None else found == value


def test_two_frames_by_hand():
    # frame 1: truth 4, found 4; frame 2: truth 4, found 5. Counts are summed: class 4 has 1/2, class 5 has 0/1
    metric = RayIoU(LINE, directions=FORWARD, thresholds_m=(1,))
    metric.update(line(c3=4), line(c3=4))
    metric.update(line(c3=5), line(c3=4))
    scores = metric.compute()
    assert scores["rayiou/4"].item() == 0.5
    assert scores["rayiou/5"].item() == 0.0
    assert math.isnan(scores["rayiou/1"].item())
    assert scores["rayiou"].item() == 0.25


def test_entry_and_exit_distances():
    wide = Cuboid(shape=(5, 1, 1), x_m=(0.0, 10.0), y_m=(-0.5, 0.5), height_m=(-0.5, 0.5))
    target = torch.zeros(1, 5, 1, 1, dtype=torch.uint8)
    target[0, 1] = 4  # 2 to 4 m
    scores = ray_iou(line(c2=4), target, LINE, directions=FORWARD, target_grid=wide, thresholds_m=(0.5,))
    assert scores["rayiou"].item() == 0.0  # left at 3 m and at 4 m
    scores = ray_iou(line(c2=4), target, LINE, directions=FORWARD, target_grid=wide, thresholds_m=(0.5,), hit="entry")
    assert scores["rayiou"].item() == 1.0  # both entered at 2 m


def test_truth_outside_the_predicted_grid_is_dropped():
    far = Cuboid(shape=(20, 1, 1), x_m=(0.0, 20.0), y_m=(-0.5, 0.5), height_m=(-0.5, 0.5))
    target = torch.zeros(1, 20, 1, 1, dtype=torch.uint8)
    target[0, 12] = 4
    assert math.isnan(ray_iou(line(), target, LINE, directions=FORWARD, target_grid=far)["rayiou"].item())
    target[0, 9] = 4
    assert ray_iou(line(c9=4), target, LINE, directions=FORWARD, target_grid=far)["rayiou"].item() == 1.0


@pytest.mark.parametrize("grid", [CYLINDER, CUBOID])
def test_perfect_and_empty_predictions(grid):
    _, target = frames(grid, 2)
    perfect = ray_iou(target.masked_fill(target == 255, 0), target.masked_fill(target == 255, 0), grid)
    assert all(value.item() == 1.0 for value in perfect.values())
    empty = ray_iou(torch.zeros_like(target), target, grid)
    assert all(value.item() == 0.0 for value in empty.values())


def test_range_bands_add_up_to_the_whole():
    prediction, target = frames(CYLINDER, 2)
    whole = RayIoU(CYLINDER)
    binned = RayIoU(CYLINDER, range_edges_m=(0.0, 5.0, 8.0))
    for metric in (whole, binned):
        metric.update(prediction, target)
    for name in ("truth", "predicted", "correct"):
        assert torch.equal(getattr(whole, name)[0], getattr(binned, name).sum(0))
        assert (getattr(binned, name).flatten(1).sum(1) > 0).all()
    assert torch.equal(whole.compute()["rayiou"], binned.compute()["rayiou"])


@pytest.mark.parametrize("free_rays", [False, True])
def test_the_score_without_classes_is_that_of_one_class(free_rays):
    prediction, target = frames(CYLINDER, 2)
    found = ray_iou(prediction, target, CYLINDER, count_free_rays=free_rays)
    merged = prediction.clamp(max=1), torch.where(target == 255, 255, target.clamp(max=1))
    alone = ray_iou(*merged, CYLINDER, num_classes=2, count_free_rays=free_rays)
    assert found["occupied/rayiou"] == alone["rayiou"] == alone["occupied/rayiou"]
    assert 0.1 < found["rayiou"] < found["occupied/rayiou"] < 1


def test_nested_ranges_hold_the_nearer_ones():
    """The score within 8 m is that of a metric with one band up to 8 m."""
    prediction, target = frames(CYLINDER, 2)
    nested = RayIoU(CYLINDER, range_edges_m=(0.0, 5.0, 8.0))
    nested.update(prediction, target)
    found = nested.compute_within()
    assert list(found) == ["rayiou_within_5m", "rayiou_within_8m"]
    for end_m in (5.0, 8.0):
        one = RayIoU(CYLINDER, range_edges_m=(0.0, end_m))
        one.update(prediction, target)
        assert torch.equal(found[f"rayiou_within_{end_m:g}m"], one.compute()[f"rayiou_0-{end_m:g}m"])
    assert len(set(map(float, found.values()))) == 2


def test_another_free_class_gives_the_same_scores():
    prediction, target = frames(CUBOID, 1)
    turned = [
        torch.where(labels == 255, 255, (labels.long() + 11) % 12).to(torch.uint8) for labels in (prediction, target)
    ]
    expected = ray_iou(prediction, target, CUBOID)
    found = ray_iou(turned[0], turned[1], CUBOID, free_index=11)
    assert found["rayiou"].item() == expected["rayiou"].item()
    assert ray_iou(prediction % 3, target.clamp(max=1), CUBOID, num_classes=3)["rayiou/1"] >= 0


def test_real_rays():
    prediction = line(c3=4, c7=5)
    cases = [
        (3.5, 4, 1.0),  # inside the cell: no error
        (4.4, 4, 1.0),  # 0.4 m behind it
        (5.0, 4, 0.0),  # 1 m behind it: not strictly below 1 m
        (2.0, 4, 0.0),
        (3.5, 5, 0.0),
        (math.inf, 0, None),
        (10.5, 4, None),  # beyond the grid
        (3.5, 255, None),
    ]
    for range_m, label, expected in cases:
        metric = RayIoU(LINE, directions=FORWARD, thresholds_m=(1,))
        metric.update_rays(prediction, torch.tensor([[range_m]]), torch.tensor([[label]], dtype=torch.uint8))
        found = metric.compute()[f"rayiou/{4 if label == 4 else 5}"].item()
        assert math.isnan(found) if expected is None else found == expected, (range_m, label)


def test_real_rays_from_the_middle_of_the_true_cells_score_like_the_cells():
    _, target = frames(CYLINDER, 2)
    target = target.masked_fill(target == 255, 0)
    directions = sparseocc_directions()
    ranges, labels = [], []
    for frame in target:
        hits = CYLINDER.cast(frame, torch.zeros_like(directions), directions)
        ranges.append(torch.where(hits.labels > 0, (hits.entry_m + hits.exit_m) / 2, math.inf))
        labels.append(hits.labels)
    metric = RayIoU(CYLINDER)
    metric.update_rays(target, torch.stack(ranges), torch.stack(labels))
    assert metric.compute()["rayiou"].item() == 1.0
    # from two origins the rays follow one another
    pair = RayIoU(CYLINDER)
    pair.update_rays(
        target, torch.cat([torch.stack(ranges)] * 2, 1), torch.cat([torch.stack(labels)] * 2, 1), torch.zeros(2, 2, 3)
    )
    assert torch.equal(pair.correct, 2 * metric.correct)


def test_compute_after_more_rays_is_not_stale():
    metric = RayIoU(LINE, directions=FORWARD)
    rays = torch.tensor([[3.5]]), torch.tensor([[4]], dtype=torch.uint8)
    metric.update_rays(line(c3=4), *rays)
    assert metric.compute()["rayiou"].item() == 1.0
    metric.update_rays(line(), *rays)
    assert metric.compute()["rayiou/4"].item() == 0.5
    metric.reset()
    assert metric.truth.sum() == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"preds": torch.zeros(1, 10, 1, 2, dtype=torch.uint8)}, r"preds.*\(B, 10, 1, 1\)"),
        ({"target": torch.zeros(1, 9, 1, 1, dtype=torch.uint8)}, r"target.*\(B, 10, 1, 1\).*\(1, 9"),
        ({"target": torch.zeros(2, 10, 1, 1, dtype=torch.uint8)}, "batch size.* 1.* 2"),
        ({"preds": torch.zeros(1, 12, 10, 1, 1)}, r"\(1, 12, 10, 1, 1\).*argmax"),
        (
            {"preds": torch.full((1, 10, 1, 1), 0.5)},
            r"preds.*\[0\.5\].*float32",
        ),
        ({"preds": torch.zeros(1, 10, 1, 1, dtype=torch.bool)}, "integer.*bool"),
        ({"origins": torch.zeros(1, 3)}, r"origins.*\(1, O, 3\).*\(1, 3\)"),
        ({"observed": torch.ones(1, 10, 1, 2, dtype=torch.bool)}, r"observed.*\(1, 10, 1, 1\)"),
        ({"observed": torch.ones(1, 10, 1, 1)}, r"observed.*bool.*float32"),
        ({"preds": line(c1=255)}, r"preds.*0\.\.11.*\[255\]"),
        ({"target": line(c1=12)}, r"target.*0\.\.11.*255.*\[12\]"),
    ],
)
def test_error_names_wrong_input(change, message):
    metric = RayIoU(LINE, directions=FORWARD)
    with pytest.raises(ValueError, match=message):
        metric.update(**{"preds": line(), "target": line()} | change)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"thresholds_m": ()}, "thresholds_m.*increasing"),
        ({"range_edges_m": (5.0,)}, "range_edges_m.*increasing"),
        ({"range_edges_m": (5.0, 1.0)}, "range_edges_m.*increasing"),
        ({"free_index": 12}, r"free_index.*0\.\.11.* 12"),
        ({"num_classes": 1}, r"num_classes.*2\.\.255.* 1"),
        ({"ignore_index": 3}, r"ignore_index.*12\.\.255"),
    ],
)
def test_error_names_wrong_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        RayIoU(LINE, **arguments)


def test_the_public_rays():
    directions = sparseocc_directions()
    assert directions.shape == (39 * 360, 3)
    elevation_deg = directions[::360, 2].double().asin().rad2deg()
    ten = [-45.0, -26.565, -18.435, -14.036, -11.310, -9.462, -8.130, -7.125, -6.340, -5.711]
    assert elevation_deg[:10].tolist() == pytest.approx(ten, abs=1e-3)
    assert (elevation_deg[10:] - elevation_deg[9:-1]).tolist() == pytest.approx([0.6296] * 29, abs=1e-3)
    assert elevation_deg[-1].item() == pytest.approx(12.548, abs=1e-3)
    azimuth_deg = torch.atan2(directions[:360, 1], directions[:360, 0]).rad2deg() % 360
    assert azimuth_deg.tolist() == pytest.approx(list(range(360)), abs=1e-4)


def three_metrics(**kwargs):
    edges_m = (0.0, 4.0, 9.0)
    return (
        RayIoU(CUBOID, range_edges_m=edges_m, **kwargs),
        VoxelIoU(**kwargs),
        DepthMetrics(range_edges_m=(0.0, 4.0), **kwargs),
    )


def as_input(metric, prediction, target):
    return (prediction + 1.0, target + 1.0) if isinstance(metric, DepthMetrics) else (prediction, target)


def half_of_the_frames(rank, folder):
    """Score every second frame; sum counts of two processes at the end, at each step, not at all."""
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/rendezvous", rank=rank, world_size=2)
    prediction, target = frames(CUBOID, 5)
    metrics = three_metrics()
    for metric in metrics:
        metric.update(*as_input(metric, prediction[rank::2], target[rank::2]))
    scores = [metric.compute() for metric in metrics]
    mine = prediction[rank::2][:2], target[rank::2][:2]
    stepped = [metric(*as_input(metric, *mine)) for metric in three_metrics(dist_sync_on_step=True)]
    alone = []
    if rank == 0:  # the other process does not take part
        for metric in three_metrics(sync_on_compute=False):
            metric.update(*as_input(metric, *mine))
            alone.append(metric.compute())
    torch.distributed.destroy_process_group()
    return scores, stepped, alone


def second_process(function, folder):
    """Start a function of this file as rank 1 in another process, which saves the result as `1.pt`."""
    code = (
        "import runpy, sys, torch; torch.set_num_threads(1);"
        "scores = runpy.run_path(sys.argv[1])[sys.argv[3]](1, sys.argv[2]);"
        "torch.save(scores, sys.argv[2] + '/1.pt')"
    )
    path = {**os.environ, "PYTHONPATH": str(Path(omniocc.__file__).parents[1])}
    return subprocess.Popen([sys.executable, "-c", code, __file__, str(folder), function], env=path)


def test_two_processes_equal_one(tmp_path):
    other = second_process("half_of_the_frames", tmp_path)
    scores = half_of_the_frames(0, tmp_path)
    assert other.wait(timeout=120) == 0
    prediction, target = frames(CUBOID, 5)
    of_both = [scores, torch.load(tmp_path / "1.pt")]
    # all frames; the first two of each process, frames 0 to 3; the first two of the first process, 0 and 2
    for part, chosen in enumerate((slice(0, 5), slice(0, 4), slice(0, 3, 2))):
        for i, expected in enumerate(three_metrics()):
            expected.update(*as_input(expected, prediction[chosen], target[chosen]))
            for theirs in of_both[: 1 if part == 2 else 2]:
                assert expected.compute().keys() == theirs[part][i].keys()
                for key, value in expected.compute().items():
                    torch.testing.assert_close(theirs[part][i][key], value, rtol=1e-7, atol=0, equal_nan=True)


def first_process_scores(rank, folder):
    """Score frames in the first of two processes; the second only joins the group and waits for the end."""
    timeout = datetime.timedelta(seconds=60)
    rendezvous = f"file://{folder}/rendezvous"
    torch.distributed.init_process_group("gloo", init_method=rendezvous, rank=rank, world_size=2, timeout=timeout)
    scores = ray_iou(*frames(CUBOID, 2), CUBOID) if rank == 0 else None
    torch.distributed.barrier()
    torch.distributed.destroy_process_group()
    return scores


def test_function_does_not_communicate_with_other_processes(tmp_path):
    other = second_process("first_process_scores", tmp_path)
    scores = first_process_scores(0, tmp_path)
    assert other.wait(timeout=120) == 0
    expected = ray_iou(*frames(CUBOID, 2), CUBOID)
    assert scores.keys() == expected.keys()
    for key, value in expected.items():
        torch.testing.assert_close(scores[key], value, rtol=0, atol=0, equal_nan=True)
