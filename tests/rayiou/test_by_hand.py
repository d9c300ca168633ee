"""Scores of a few rays and cells, computed by hand, at the edges of bands, thresholds and grids."""

import math

import pytest
import torch
from torchmetrics import MetricCollection

from omniocc.geometry import Cuboid
from omniocc.metric import CalibrationError, DepthMetrics, RayIoU, RayTruth, VoxelIoU, ray_hits

LINE = Cuboid((10, 1, 1), (0.0, 10.0), (-0.5, 0.5), (-0.5, 0.5))
AHEAD = torch.tensor([[1.0, 0.0, 0.0]])


def car_at(cell: int, cells: int = 10) -> torch.Tensor:
    labels = torch.zeros(1, cells, 1, 1, dtype=torch.uint8)
    labels[0, cell] = 4
    return labels


def test_calibration_error_is_the_distance_of_confidence_and_share_in_each_bin():
    metric = CalibrationError(bins=2)
    metric.update(torch.tensor([0.4, 0.9]), torch.tensor([True, False]))
    assert metric.compute()["ece"].item() == pytest.approx((0.6 + 0.9) / 2)


def test_errors_of_an_index_are_counted_above_each_percentage():
    """With 100 spheres from 1 m to infinity the index of a range is 99 / range: 50, and 52, 54, 56 predicted."""
    metric = DepthMetrics(nearest_m=1.0, farthest_m=math.inf, spheres=100)
    metric.update(torch.tensor([99 / 52, 99 / 54, 99 / 56]).double(), torch.full((3,), 99 / 50).double())
    scores = metric.compute()
    assert [scores[f"index>{k}"].item() for k in (1, 3, 5)] == pytest.approx([1, 2 / 3, 1 / 3])


def test_ratios_of_ranges_are_counted_below_each_limit():
    """The ratios are 1.1, 1.5, 1.9 and 2, the limits 1.25, 1.5625 and 1.953."""
    metric = DepthMetrics(nearest_m=1.0, farthest_m=30.0)
    metric.update(torch.tensor([11.0, 15.0, 19.0, 20.0]), torch.full((4,), 10.0))
    assert [metric.compute()[f"delta{k}"].item() for k in (1, 2, 3)] == pytest.approx([0.25, 0.5, 0.75])


def test_a_range_at_an_edge_is_of_the_band_that_begins_there():
    metric = DepthMetrics(nearest_m=1.0, farthest_m=30.0, range_edges_m=(0.0, 4.0, 8.0))
    metric.update(torch.tensor([5.0, 8.0, 3.0]), torch.tensor([4.0, 5.0, 3.0]))
    found = metric.compute()
    assert found["mae_0-4m"].item() == 0
    assert found["mae_4-8m"].item() == pytest.approx(2.0)
    assert found["rmse_4-8m"].item() == pytest.approx(math.sqrt((1 + 9) / 2))
    rays = RayIoU(LINE, directions=AHEAD, range_edges_m=(0.0, 4.0, 8.0))
    rays.update(car_at(3), car_at(3))  # left at 4 m
    assert rays.truth[:, 4].tolist() == [0, 1, 0]


def test_ranges_within_a_distance_hold_the_nearer_ones():
    metric = RayIoU(LINE, directions=AHEAD, range_edges_m=(0.0, 5.0, 10.0), split_origins=True)
    metric.update(car_at(2), car_at(2))
    metric.update(torch.zeros_like(car_at(7)), car_at(7))
    found = {key: value.item() for key, value in metric.compute_within().items()}
    assert found == {"rayiou_within_5m": 1.0, "rayiou_within_10m": 0.5}


def test_every_option_that_decides_what_is_counted_keeps_metrics_apart():
    both = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    kinds = {"fine": {"fine_thresholds_m": (1,)}, "free": {"count_free_rays": True}, "rays": {"directions": both}}
    made = {name: RayIoU(LINE, **{"directions": AHEAD, **options}) for name, options in kinds.items()}
    metrics = MetricCollection({"plain": RayIoU(LINE, directions=AHEAD), **made})
    metrics.update(car_at(3), car_at(3))
    assert len(metrics.compute_groups) == 4


def test_measured_points_count_in_the_grid_from_where_the_ray_starts():
    """From 8 m, points 1.5 m ahead are in the grid of 10 m, points 4 m ahead are not."""
    metric = RayIoU(LINE)
    starts = torch.tensor([[[8.0, 0, 0], [8.0, 0, 0]]])
    labels = torch.tensor([[4, 4]], dtype=torch.uint8)
    metric.update(car_at(9), RayTruth(torch.tensor([[1.5, 4.0]]), labels, AHEAD.expand(1, 2, 3), starts))
    assert metric.truth.sum() == 1


def test_true_cells_of_another_grid_count_if_their_middle_is_in_the_prediction():
    """The last of four cells of 3 m is from 9 to 12 m, its middle outside of the 10 m of the prediction."""
    other = Cuboid((4, 1, 1), (0.0, 12.0), (-0.5, 0.5), (-0.5, 0.5))
    metric = RayIoU(LINE, directions=AHEAD, target_grid=other)
    metric.update(torch.zeros_like(car_at(0)), car_at(3, cells=4))
    assert metric.truth.sum() == 0


def test_f1_of_unequal_precision_and_recall():
    """Precision is 1/4 and recall 1."""
    metric = VoxelIoU()
    rows = ([1, 1, 1, 1, 0], [1, 0, 0, 0, 0])
    metric.update(*(torch.tensor(row, dtype=torch.uint8).reshape(1, -1, 1, 1) for row in rows))
    assert metric.compute()["f1"].item() == pytest.approx(0.4)


@pytest.mark.parametrize(("own_rays", "count_free_rays"), [(False, False), (False, True), (True, False)])
def test_rays_that_did_not_come_back_are_left_out_whatever_their_label(count_free_rays, own_rays):
    """LiDARs write 0, -1 or nan where nothing came back; the second ray ends in the cell that is predicted."""
    metric = RayIoU(LINE, directions=AHEAD.expand(2, 3), count_free_rays=count_free_rays)
    cases = [(range_m, label) for range_m in (0.0, -1.0, math.nan, -math.inf) for label in (4.0, 0.0, math.nan, 3.6)]
    for range_m, label in cases:
        ranges, labels = torch.tensor([[range_m, 3.5]]), torch.tensor([[label, 4.0]])
        if own_rays:
            rays = torch.stack([torch.full((3,), math.nan), AHEAD[0]])[None]
            metric.update(car_at(3), RayTruth(ranges, labels, rays, torch.tensor([[[math.nan] * 3, [0.0] * 3]])))
        else:
            metric.update_rays(car_at(3), ranges, labels)
    assert metric.truth.sum() == metric.truth[:, 4].sum() == len(cases)
    assert metric.predicted.sum() == len(cases)
    assert metric.compute()["rayiou"] == 1
    with pytest.raises(ValueError, match=r"labels must hold class ids 0..11 or 255, got \[3.5"):
        RayIoU(LINE, directions=AHEAD).update_rays(car_at(3), torch.tensor([[3.5]]), torch.tensor([[3.5]]))


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_origins_that_are_not_finite_are_refused(wrong):
    origins, metric = torch.tensor([[[0.0, 0.0, 0.0], [1.0, wrong, 0.0]]]), RayIoU(LINE, directions=AHEAD)
    words = rf"must be finite, got \[1.0, {wrong}, 0.0\] among 1 that are not"
    with pytest.raises(ValueError, match="origins " + words):
        metric.update(car_at(3), car_at(3), origins)
    with pytest.raises(ValueError, match="origins " + words):
        metric.update_rays(car_at(3), torch.tensor([[3.5, 2.5]]), torch.tensor([[4, 4]]), origins)
    with pytest.raises(ValueError, match="origins " + words):
        ray_hits(car_at(3)[0], LINE, origins[0], AHEAD)
    rays = RayTruth(torch.tensor([[3.5, 2.5]]), torch.tensor([[4, 4]]), AHEAD.expand(1, 2, 3), origins)
    with pytest.raises(ValueError, match="starts " + words):
        metric.update(car_at(3), rays)
