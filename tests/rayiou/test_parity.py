"""RayIoU on cuboids against an independent numpy version of the public protocol, from the published rules."""

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid
from omniocc.metric import RayIoU, ray_hits, sparseocc_directions

GRID = Cuboid((200, 200, 16), x_m=(-40.0, 40.0), y_m=(-40.0, 40.0), height_m=(-1.0, 5.4))
LOW, CELL_M = np.array([-40.0, -40.0, -1.0]), 0.4


def walk(labels, origin_m, directions):
    """Cast rays after Amanatides and Woo as the public kernel; the start is truncated, ties go to y before x and to z.

    Returns range (exit of the cell hit, else of the grid), class, flat cell, and whether the ray met an edge.
    """
    start, rays = (np.asarray(origin_m) - LOW) / CELL_M, np.arange(len(directions))
    cell = np.repeat(start.astype(int)[None], len(rays), axis=0)
    step = np.where(directions >= 0, 1, -1)
    with np.errstate(divide="ignore"):
        wide = np.where(directions == 0, np.inf, 1 / np.abs(directions))
        border = np.where(directions == 0, np.inf, (cell + (step > 0) - start) / directions)
    range_vox, found, hit_cell = np.zeros(len(rays)), np.zeros(len(rays), np.uint8), np.zeros(len(rays), int)
    edge = np.zeros(len(rays), bool)
    while len(rays):
        x, y, z = border[rays].T
        axis = np.where(x < y, np.where(x < z, 0, 2), np.where(y < z, 1, 2))
        edge[rays] |= np.diff(np.sort(border[rays], axis=1)[:, :2], axis=1)[:, 0] < 1e-9
        here = tuple(cell[rays].T)
        range_vox[rays], found[rays] = border[rays, axis], labels[here]
        hit_cell[rays] = np.ravel_multi_index(here, labels.shape)
        cell[rays, axis] += step[rays, axis]
        border[rays, axis] += wide[rays, axis]
        inside = ((cell[rays] >= 0) & (cell[rays] < labels.shape)).all(1)
        rays = rays[inside & (found[rays] == 0)]
    return range_vox * CELL_M, found, hit_cell, edge


def count(pairs, num_classes=12, thresholds_m=(1, 2, 4)):
    """Return IoU by threshold and class from (true range, true class, range, class), as the public script."""
    true_m, true, ours_m, ours = (np.concatenate(part) for part in zip(*pairs, strict=True))
    valid = true != 0
    true_m, true, ours_m, ours = true_m[valid], true[valid], ours_m[valid], ours[valid]
    gt, pr = np.bincount(true, minlength=num_classes), np.bincount(ours, minlength=num_classes)
    iou = []
    for threshold_m in thresholds_m:
        good = (true == ours) & (np.abs(true_m - ours_m) < threshold_m)
        tp = np.bincount(true[good], minlength=num_classes)
        with np.errstate(invalid="ignore"):
            iou.append(tp / (gt + pr - tp))
    return np.array(iou)[:, 1:], gt, pr


def scene(seed):
    """Return truth and a prediction that is mostly right."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(1, 12, GRID.shape).astype(np.uint8)
    truth[rng.random(GRID.shape) > 0.004] = 0
    truth[:, :, 0] = 1
    moved = np.where(rng.random(GRID.shape) < 0.1, np.roll(truth, 2, axis=0), truth)
    return truth, np.where(rng.random(GRID.shape) < 0.05, rng.integers(0, 12, GRID.shape), moved).astype(np.uint8)


def test_equal_to_the_last_count():
    rays = sparseocc_directions().numpy()
    origins = [[0.985793, 0.137, 1.84019], [-17.31, 8.47, 1.6]]
    metric, pairs = RayIoU(GRID), []
    for frame in range(2):
        truth, ours = scene(frame)
        pairs += [(*walk(truth, origin, rays)[:2], *walk(ours, origin, rays)[:2]) for origin in origins]
        volumes = torch.from_numpy(ours)[None], torch.from_numpy(truth)[None]
        metric.update(*volumes, torch.tensor([origins], dtype=torch.float64))
    iou, gt, pr = count(pairs)
    assert metric.truth[0].tolist() == gt.tolist()
    assert metric.predicted[0].tolist() == pr.tolist()
    scores = metric.compute()
    assert scores["rayiou"].item() == pytest.approx(np.nanmean(iou), abs=1e-7)
    for t, threshold in enumerate("124"):
        assert scores[f"rayiou@{threshold}"].item() == pytest.approx(np.nanmean(iou[t]), abs=1e-7)
    for c in range(11):
        assert scores[f"rayiou/{c + 1}"].item() == pytest.approx(np.nanmean(iou[:, c]), abs=1e-7)
    union = metric.truth[0] + metric.predicted[0] - metric.correct[0]
    np.testing.assert_array_equal((metric.correct[0] / union)[:, 1:].numpy(), iou.astype(np.float32))


def test_only_rays_through_edges_may_differ():
    """Cast rays from a corner of four columns: rays along the diagonals and many others hit edges.

    Rays here continue in the opposite cell; the public kernel passes a cell beside it over no length, and may hit it.
    """
    directions = sparseocc_directions()
    truth, _ = scene(2)
    hits = ray_hits(torch.from_numpy(truth), GRID)
    range_m, labels, cells, edge = walk(truth, [0.0, 0.0, 0.0], directions.numpy())
    same = (hits.cells.numpy() == np.where(labels == 0, -1, cells)) & (np.abs(hits.exit_m.numpy() - range_m) < 1e-5)
    assert same[~edge].all()
    assert 0 < (~same).sum() < 100 < edge.sum()
