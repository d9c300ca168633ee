"""Options of RayIoU beyond the public protocol."""

import math
import pickle
from importlib.util import find_spec

import pytest
import torch
from torchmetrics import MetricCollection

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import CandidateScores, RayIoU, VoxelIoU, ray_hits, ray_iou

LINE = Cuboid(shape=(10, 1, 1), x_m=(0.0, 10.0), y_m=(-0.5, 0.5), height_m=(-0.5, 0.5))
LONG = Cuboid(shape=(20, 1, 1), x_m=(0.0, 20.0), y_m=(-0.5, 0.5), height_m=(-0.5, 0.5))
SMALL = Cylinder(shape=(16, 20, 6), radius_m=(0.0, 12.0), height_m=(-2.8, 3.2))
FORWARD = torch.tensor([[1.0, 0.0, 0.0]])


def line(length=10, **cells):
    labels = torch.zeros(1, length, 1, 1, dtype=torch.uint8)
    for place, label in cells.items():
        labels[0, int(place[1:])] = label
    return labels


def frames(grid, count, seed=0):
    generator = torch.Generator().manual_seed(seed)
    target = torch.randint(1, 12, (count, *grid.shape), generator=generator, dtype=torch.uint8)
    target[torch.rand(target.shape, generator=generator) < 0.95] = 0
    return torch.where(torch.rand(target.shape, generator=generator) < 0.7, target, target.roll(1, 1)), target


def counts(metric):
    return metric.truth.sum(0).tolist(), metric.predicted.sum(0).tolist(), metric.correct.sum((0, 1)).tolist()


def test_hallucinations_on_free_rays_cost_their_class_when_counted():
    strict, public = (RayIoU(LINE, directions=FORWARD, thresholds_m=(1,), count_free_rays=on) for on in (True, False))
    for prediction, target in (
        (line(c3=4), line(c3=4)),
        (line(c5=4), line()),
        (line(c5=4), line(c2=255)),
        (line(), line()),
    ):
        strict.update(prediction, target)
        public.update(prediction, target)
    assert public.compute()["rayiou/4"].item() == 1.0
    assert strict.compute()["rayiou/4"].item() == 0.5  # the ray that ends in unknown still does not count
    truth, predicted, correct = counts(strict)
    assert (truth[0], truth[4], predicted[0], predicted[4], correct[0], correct[4]) == (2, 1, 1, 2, 1, 1)


def test_free_rays_count_in_the_band_where_they_leave_the_grid():
    metric = RayIoU(LINE, directions=FORWARD, range_edges_m=(0.0, 9.0, 11.0), count_free_rays=True)
    metric.update(line(c2=4), line())
    assert metric.predicted[:, 4].tolist() == [0, 1, 0]


def test_a_ray_that_misses_the_grid_does_not_count():
    metric = RayIoU(LINE, directions=FORWARD, count_free_rays=True)
    metric.update(line(c2=4), line(), torch.tensor([[[0.0, 5.0, 0.0]]]))
    assert metric.truth.sum() == metric.predicted.sum() == 0


def test_free_ray_does_not_count_beyond_the_grid_of_the_truth():
    for place, hallucinations in (("c5", 1), ("c15", 0)):
        metric = RayIoU(LONG, directions=FORWARD, target_grid=LINE, count_free_rays=True)
        metric.update(line(20, **{place: 4}), line())
        assert metric.predicted.sum(0)[4] == hallucinations


@pytest.mark.parametrize(
    ("range_m", "label", "prediction", "expected"),
    [
        (math.inf, 0, "c5", (1, 1)),  # nothing along the whole ray
        (12.0, 4, "c5", (1, 1)),  # the point is beyond the grid, so the grid is free
        (4.0, 0, "c5", (0, 0)),  # free up to 4 m only: 5 m is unknown
        (4.0, 0, "c2", (1, 1)),
        (5.5, 4, "c5", (0, 0)),  # not a free ray
        (math.inf, 255, "c5", (0, 0)),
    ],
)
def test_free_real_rays(range_m, label, prediction, expected):
    metric = RayIoU(LINE, directions=FORWARD, count_free_rays=True)
    metric.update_rays(line(**{prediction: 7}), torch.tensor([[range_m]]), torch.tensor([[label]]))
    truth, predicted, _ = counts(metric)
    assert (truth[0], predicted[7] if label != 4 or range_m > 10 else 0) == expected


def test_cells_not_observed_are_unknown():
    prediction, target = line(c3=4), line(c2=5, c3=4)
    observed = torch.ones_like(target, dtype=torch.bool)
    observed[0, 2] = False
    assert ray_iou(prediction, target, LINE, directions=FORWARD)["rayiou"].item() == 0.0
    # the ray ends in the unknown cell with any label
    masked = ray_iou(prediction, target, LINE, observed=observed, directions=FORWARD)
    assert math.isnan(masked["rayiou"].item())
    observed[0, 2:4] = torch.tensor([True, False]).reshape(2, 1, 1)
    assert ray_iou(line(c2=5), target, LINE, observed=observed, directions=FORWARD)["rayiou"].item() == 1.0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.int64, torch.int8])
def test_every_number_type_that_can_hold_the_ids(dtype):
    prediction, target = frames(SMALL, 1)
    expected = ray_iou(prediction, target, SMALL)
    found = ray_iou(prediction.to(dtype), target.to(dtype), SMALL)
    assert all(torch.equal(found[key], expected[key]) for key in expected)
    with pytest.raises(ValueError, match=r"preds.*class ids"):
        ray_iou((prediction.float() - 1).to(dtype), target, SMALL)


def test_batches_forward_and_single_frames_agree():
    prediction, target = frames(SMALL, 4)
    whole, parts = RayIoU(SMALL), RayIoU(SMALL)
    whole.update(prediction, target)
    for i in range(4):
        value = parts(prediction[i : i + 1], target[i : i + 1])
        assert torch.equal(value["rayiou"], ray_iou(prediction[i : i + 1], target[i : i + 1], SMALL)["rayiou"])
    assert counts(parts) == counts(whole)
    origins = torch.rand(4, 2, 3, generator=torch.Generator().manual_seed(1)) * 4
    twice, once = RayIoU(SMALL), RayIoU(SMALL)
    twice.update(prediction, target, origins)
    for i in (2, 0, 3, 1):
        for o in range(2):
            once.update(prediction[i : i + 1], target[i : i + 1], origins[i : i + 1, o : o + 1])
    assert counts(once) == counts(twice)


def test_collection_clone_and_prefix():
    prediction, target = frames(SMALL, 2)
    metrics = MetricCollection({"rays": RayIoU(SMALL), "voxels": VoxelIoU()}, prefix="val/")
    test = metrics.clone(prefix="test/")
    metrics.update(prediction, target)
    scores = metrics.compute()
    assert scores["val/rayiou"].item() == ray_iou(prediction, target, SMALL)["rayiou"].item()
    assert 0 < scores["val/miou"].item() < 1
    assert all(key.startswith("test/") for key in test(prediction, target))
    metrics.reset()
    assert metrics["rays"].truth.sum() == 0


def test_memory_does_not_grow_with_frames():
    prediction, target = frames(SMALL, 1)
    metric = RayIoU(SMALL, range_edges_m=(0.0, 5.0, 10.0))
    sizes = set()
    for i in range(12):
        metric.update(prediction, target, torch.full((1, 2, 3), i / 10))
        sizes.add(len(pickle.dumps(metric)))
    assert len(sizes) == 1
    assert sum(getattr(metric, name).numel() for name in ("truth", "predicted", "correct")) == 3 * 12 * (1 + 1 + 3)


@pytest.mark.parametrize(("by", "bars"), [("class", 11), ("threshold", 3), ("range", 2)])
def test_plot(by, bars):
    metric = RayIoU(SMALL, range_edges_m=(0.0, 5.0, 10.0))
    metric.update(*frames(SMALL, 1))
    if find_spec("matplotlib") is None:
        with pytest.raises(ImportError, match="pip install matplotlib"):
            metric.plot(by=by)
        return
    import matplotlib

    matplotlib.use("agg")
    figure, axes = metric.plot(by=by)
    assert len(axes.patches) == bars
    assert metric.plot(metric.compute(), axes, by=by)[0] is figure
    expected = metric.compute()[{"class": "rayiou/1", "threshold": "rayiou@1", "range": "rayiou_0-5m"}[by]]
    assert axes.patches[0].get_height() == pytest.approx(expected.item())
    matplotlib.pyplot.close(figure)


def road(grid):
    """Return labels with road in the three lowest levels."""
    labels = torch.zeros(1, *grid.shape, dtype=torch.uint8)
    labels[0, :, :, :3] = 1
    return labels


def test_cylinder_and_cuboid_agree_on_the_road():
    """Compare entry distances, which are equal as both roads are entered through the same plane."""
    cylinder = Cylinder(shape=(40, 60, 8), radius_m=(0.0, 10.0), height_m=(-2.8, 3.6))
    cuboid = Cuboid(shape=(50, 50, 8), x_m=(-15.0, 15.0), y_m=(-15.0, 15.0), height_m=(-2.8, 3.6))
    for geometry, target in ((cylinder, cuboid), (cuboid, cylinder)):
        metric = RayIoU(geometry, target_grid=target, hit="entry", thresholds_m=(1e-4,))
        metric.update(road(geometry), road(target))
        assert metric.compute()["rayiou/1"].item() == 1.0
        assert metric.truth.sum() > 1000


def test_ray_hits_are_those_of_trace():
    prediction, _ = frames(SMALL, 1)
    origins = torch.tensor([[0.0, 0.0, 0.0], [2.0, 1.0, 0.5]])
    directions = torch.randn(50, 3, generator=torch.Generator().manual_seed(0))
    hits = ray_hits(prediction[0], SMALL, origins, directions)
    starts, rays = origins.repeat_interleave(50, 0), directions.repeat(2, 1)
    range_m, labels = SMALL.trace(prediction[0], starts, rays, hit="entry")
    torch.testing.assert_close(hits.entry_m, range_m, rtol=0, atol=4e-6)
    assert torch.equal(hits.labels, labels)
    hit = hits.cells >= 0
    assert torch.equal(prediction[0].flatten()[hits.cells[hit].long()], hits.labels[hit])
    turned = ray_hits((prediction[0] + 11) % 12, SMALL, origins, directions, free_index=11)
    assert torch.equal(turned.cells, hits.cells)
    assert torch.equal((turned.labels + 1) % 12, hits.labels)


@pytest.mark.parametrize("metric", [RayIoU, CandidateScores])
def test_a_shape_is_no_grid(metric):
    with pytest.raises(ValueError, match=r"grid must be a grid, .*Cuboid\(shape, x_m.*got tuple"):
        metric((200, 200, 16))
    with pytest.raises(ValueError, match="target_grid must be a grid"):
        RayIoU(SMALL, target_grid=(200, 200, 16))
