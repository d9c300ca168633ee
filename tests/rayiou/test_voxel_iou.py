import math

import pytest
import torch

from omniocc.geometry import Cylinder
from omniocc.metric import VoxelIoU


def test_by_hand_over_two_batches():
    # truth:      free Road Road Wall Wall unknown | Road free
    # prediction: Road Road free Wall Road Road    | Road free
    metric = VoxelIoU()
    metric.update(voxels(1, 1, 0, 5, 1, 1), voxels(0, 1, 1, 5, 5, 255))
    metric.update(voxels(1, 0), voxels(1, 0))
    scores = metric.compute()
    assert scores["iou/1"].item() == pytest.approx(2 / 5)
    assert scores["iou/5"].item() == pytest.approx(1 / 2)
    assert math.isnan(scores["iou/9"].item())
    assert scores["miou"].item() == pytest.approx((2 / 5 + 1 / 2) / 2)
    assert scores["iou"].item() == pytest.approx(4 / 6)
    assert scores["precision"].item() == pytest.approx(4 / 5)
    assert scores["recall"].item() == pytest.approx(4 / 5)
    assert scores["f1"].item() == pytest.approx(4 / 5)
    assert len(scores) == 5 + 11


def test_cells_not_observed_do_not_count():
    metric = VoxelIoU()
    observed = torch.tensor([True, False, True, True]).reshape(1, 4, 1, 1)
    metric.update(voxels(1, 1, 0, 5), voxels(1, 0, 0, 255), observed)
    scores = metric.compute()
    assert scores["iou"].item() == scores["miou"].item() == 1.0
    assert metric.confusion.sum() == 2


def test_a_cylinders_cells_count_by_their_volume():
    grid = Cylinder(shape=(2, 4, 1), radius_m=(0.0, 2.0), height_m=(0.0, 1.0))
    target = torch.zeros(1, 2, 4, 1, dtype=torch.uint8)
    target[0, :, 0] = 1
    prediction = target.clone()
    prediction[0, 0, 0] = 0  # the inner cell of the sector, a quarter of its volume, is missed
    by_cell, by_volume = VoxelIoU(), VoxelIoU(grid=grid)
    for metric in (by_cell, by_volume):
        metric.update(prediction, target)
    assert by_cell.compute()["recall"].item() == pytest.approx(1 / 2)
    assert by_volume.compute()["recall"].item() == pytest.approx(3 / 4)
    assert by_volume.confusion.sum().item() == pytest.approx(4 * math.pi)


def test_other_classes():
    metric = VoxelIoU(num_classes=3, free_index=2, ignore_index=9)
    metric.update(voxels(0, 1, 2, 2), voxels(0, 0, 2, 9))
    scores = metric.compute()
    assert scores["iou"].item() == 1.0
    assert (scores["iou/0"].item(), scores["iou/1"].item()) == (0.5, 0.0)


def voxels(*labels):
    return torch.tensor(labels, dtype=torch.uint8).reshape(1, -1, 1, 1)


def test_agrees_with_a_plain_loop():
    generator = torch.Generator().manual_seed(0)
    target = torch.randint(0, 12, (3, 5, 6, 4), generator=generator, dtype=torch.uint8)
    prediction = torch.where(torch.rand(target.shape, generator=generator) < 0.5, target, target.flip(0))
    target[target == 3] = 255
    metric = VoxelIoU()
    for i in range(3):
        metric.update(prediction[i : i + 1], target[i : i + 1])
    scores = metric.compute()
    pairs = [(t, p) for t, p in zip(target.flatten().tolist(), prediction.flatten().tolist(), strict=True) if t != 255]
    both = sum(t > 0 and p > 0 for t, p in pairs)
    assert scores["iou"].item() == pytest.approx(both / sum(t > 0 or p > 0 for t, p in pairs))
    assert scores["precision"].item() == pytest.approx(both / sum(p > 0 for _, p in pairs))
    assert scores["recall"].item() == pytest.approx(both / sum(t > 0 for t, _ in pairs))
    per_class = [sum(t == c == p for t, p in pairs) / sum(t == c or p == c for t, p in pairs) for c in range(1, 12)]
    assert scores["miou"].item() == pytest.approx(sum(per_class) / 11)


def test_error_names_wrong_input():
    metric = VoxelIoU()
    with pytest.raises(ValueError, match="same shape"):
        metric.update(voxels(1, 1), voxels(1))
    with pytest.raises(ValueError, match=r"preds.*0\.\.11.*\[255\]"):
        metric.update(voxels(255), voxels(1))
    with pytest.raises(ValueError, match=r"target.*0\.\.11.*255.*\[77\]"):
        metric.update(voxels(1), voxels(77))
    with pytest.raises(ValueError, match=r"\[1\.5\].*float32"):
        metric.update(voxels(1) + 0.5, voxels(1))
