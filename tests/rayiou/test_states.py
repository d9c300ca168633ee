"""Metrics keep their counts exact and apart: casts of modules, states of other settings, groups, sums of processes."""

import copy
import pickle

import pytest
import torch
from metric_batches import FORWARD, GRID, LINE, METRICS, batch, counted, made, same
from torch import nn
from torchmetrics import BootStrapper, MetricCollection, MetricTracker

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import CalibrationError, CandidateScores, DepthMetrics, RayIoU, RayTruth, VoxelIoU

WIDE = Cylinder((8, 12, 4), (0.0, 24.0), (-2.8, 3.2))
BANDS = {"range_edges_m": (0.0, 4.0, 9.0)}
KEYS = {"rays": "rayiou", "voxels": "miou", "depth": "mae", "calibration": "ece", "candidates": "recall"}
OTHERS = {
    "rays": [
        RayIoU(WIDE),
        RayIoU(GRID, thresholds_m=(1, 2, 3)),
        RayIoU(GRID, hit="entry"),
        RayIoU(GRID, ignore_index=99),
        RayIoU(GRID, count_free_rays=True),
        RayIoU(GRID, num_classes=18),
        RayIoU(GRID, **BANDS),
        RayIoU(GRID, directions=FORWARD),
        RayIoU(GRID, target_grid=WIDE),
        RayIoU(GRID, fine_thresholds_m=(0.5,)),
        RayIoU(GRID, split_origins=True),
        RayIoU(GRID, free_index=3),
    ],
    "voxels": [
        VoxelIoU(grid=GRID),
        VoxelIoU(ignore_index=99),
        VoxelIoU(free_index=3),
        VoxelIoU(num_classes=18),
    ],
    "depth": [DepthMetrics(1.0), DepthMetrics(farthest_m=50.0), DepthMetrics(spheres=96), DepthMetrics(**BANDS)],
    "calibration": [CalibrationError(10)],
    "candidates": [CandidateScores(WIDE), CandidateScores(GRID, (0.0, 4.0, 9.0, 25.6))],
}
PAIRS = [(name, other) for name, others in OTHERS.items() for other in others]


@pytest.fixture(params=METRICS)
def name(request):
    return request.param


CASTS = {
    "half": lambda module: module.half(),
    "to": lambda module: module.to("cpu", torch.bfloat16),
    "type": lambda module: module.type(torch.float64),
}


@pytest.mark.parametrize("cast", CASTS)
def test_casts_of_the_module_around_it_change_no_count(name, cast):
    expected = counted(name, 0, 1).compute()
    module = CASTS[cast](nn.ModuleDict({"metric": made(name), "layer": nn.Linear(2, 2)}))
    metric = module["metric"]
    metric.update(*batch(name, 0))
    metric.compute()
    CASTS[cast](module)
    metric.update(*batch(name, 1))
    same(metric.compute(), expected)
    metric.reset()
    assert {key: (value.dtype, value.sum()) for key, value in metric.metric_state.items()} == {
        key: (value.dtype, value.sum()) for key, value in made(name).metric_state.items()
    }


def test_a_set_type_changes_no_count(name):
    metric = counted(name, 0).set_dtype(torch.float16)
    metric.update(*batch(name, 1))
    same(metric.compute(), counted(name, 0, 1).compute())


def test_more_cells_than_half_precision_counts():
    """Of 80,000 cells, half are found; float16 ends at 65,504."""
    target = torch.ones(1, 40, 100, 20, dtype=torch.uint8)
    preds = target.clone()
    preds[:, :20] = 0
    metric = VoxelIoU().to(torch.float16)
    metric.update(preds, target)
    assert metric.confusion[1, :2].tolist() == [40000, 40000]
    assert metric.compute()["iou"] == metric.compute()["recall"] == 0.5


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64])
def test_the_default_type_changes_nothing(name, dtype):
    arguments, expected = batch(name), counted(name, 0).compute()
    torch.set_default_dtype(dtype)
    try:
        metric = made(name)
        metric.update(*arguments)
        found = metric.compute()
    finally:
        torch.set_default_dtype(torch.float32)
    same(found, expected)


@pytest.mark.parametrize(("name", "other"), PAIRS)
def test_counts_of_other_settings_are_refused(name, other):
    metric = counted(name, 0)
    before = {key: value.clone() for key, value in metric.metric_state.items()}
    other.persistent(True)
    metric.persistent(True)
    for refused in (
        lambda: metric.merge_state(other),
        lambda: metric.merge_state(other.metric_state),
        lambda: metric.load_state_dict(other.state_dict()),
        lambda: nn.ModuleList([metric]).load_state_dict(nn.ModuleList([other]).state_dict()),
        lambda: gathered(metric, other),
    ):
        with pytest.raises(ValueError, match=r"counts cannot be .* counted with other arguments .* same ones"):
            refused()
        assert all(torch.equal(metric.metric_state[key], value) for key, value in before.items())
    same(metric.compute(), counted(name, 0).compute())


@pytest.mark.parametrize(("name", "other"), [(name, others[0]) for name, others in OTHERS.items()])
def test_groups_of_a_collection_hold_one_setting(name, other):
    """After the first batch, which is empty, all states are equal."""
    metrics = MetricCollection({"one": made(name), "same": made(name), "other": other.clone()})
    metrics.update(*(part[:0] for part in batch(name)))
    metrics.update(*batch(name, 1))
    assert sorted(map(sorted, metrics.compute_groups.values())) == [["one", "same"], ["other"]]
    alone = {"one": made(name), "same": made(name), "other": other.clone()}
    for key, metric in metrics.items():
        alone[key].update(*batch(name, 1))
        same(metric.compute(), alone[key].compute())


def test_cells_and_volumes_stay_apart_after_a_batch_of_unknown_cells():
    """Of two rings the outer one, of three times the volume, is missed."""
    grid = Cylinder((2, 4, 1), (0.0, 4.0), (0.0, 1.0))
    target = torch.ones(1, *grid.shape, dtype=torch.uint8)
    preds = target.clone()
    preds[:, 1] = 0
    metrics = MetricCollection({"cells": VoxelIoU(), "volumes": VoxelIoU(grid=grid)})
    metrics.update(preds, torch.full_like(target, 255))
    metrics.update(preds, target)
    found = metrics.compute()
    assert (found["cells_iou"], found["volumes_iou"]) == (0.5, pytest.approx(0.25))


def test_settings_are_equal_if_their_values_are():
    pairs = [
        (DepthMetrics(1, 50, range_edges_m=(0, 10)), DepthMetrics(1.0, 50.0, range_edges_m=[0.0, 10.0])),
        (RayIoU(GRID, thresholds_m=(1, 2)), RayIoU(copy.deepcopy(GRID), thresholds_m=[1.0, 2.0])),
        (VoxelIoU(grid=GRID, class_names=tuple("abcdefghijkl")), VoxelIoU(grid=copy.deepcopy(GRID))),
    ]
    for one, two in pairs:
        one.merge_state(two)


def test_counts_are_merged(name):
    both = counted(name, 0, 1).compute()
    for given in (lambda other: other, lambda other: other.metric_state):
        metric, other = counted(name, 0), counted(name, 1)
        metric.compute()
        metric.merge_state(given(other))
        same(metric.compute(), both)
        same(other.compute(), counted(name, 1).compute())
    empty = made(name)
    empty.merge_state(counted(name, 0, 1))
    assert empty.update_count == 2
    same(empty.compute(), both)
    with pytest.raises(ValueError, match="instance of"):
        empty.merge_state(CalibrationError() if name != "calibration" else VoxelIoU())


def test_states_of_before_there_was_a_setting_are_added():
    metric, other = counted("voxels", 0), counted("voxels", 1)
    metric.merge_state({"confusion": other.confusion})
    same(metric.compute(), counted("voxels", 0, 1).compute())
    metric = made("voxels")
    metric.load_state_dict({"confusion": other.confusion}, strict=False)
    same(metric.compute(), other.compute())
    with pytest.raises(ValueError, match="other arguments"):
        metric.load_state_dict({"confusion": torch.zeros(4, 4)})


def test_saved_states_are_loaded(name):
    metric = counted(name, 0)
    assert metric.state_dict() == {}  # unless they are asked for
    metric.persistent(True)
    saved = metric.state_dict()
    twin = counted(name, 1)
    twin.persistent(True)
    twin.compute()
    twin.load_state_dict(saved)
    same(twin.compute(), metric.compute())
    twin.update(*batch(name, 1))
    same(twin.compute(), counted(name, 0, 1).compute())
    again = made(name)
    again.load_state_dict(saved)  # which later updates of the other left as they were
    same(again.compute(), metric.compute())
    cast = {key: value.float() for key, value in saved.items()}
    again.load_state_dict(cast)
    assert {key: value.dtype for key, value in again.metric_state.items()} == {
        key: value.dtype for key, value in metric.metric_state.items()
    }


def gathered(metric, other):
    """Sync with another process, which is played by `other`."""
    theirs = iter([getattr(other, state) for state in metric._reductions])
    metric.sync(lambda value, group=None: [value, next(theirs)], distributed_available=lambda: True)


def test_sums_of_two_processes(name):
    metric = made(name, sync_on_compute=False)
    metric.update(*batch(name, 0))
    gathered(metric, counted(name, 1))
    same(metric.compute(), counted(name, 0, 1).compute())
    metric._computed = None  # `compute` has undone the sync
    same(metric.compute(), counted(name, 0).compute())


@pytest.mark.parametrize("groups", [True, False])
def test_collections_name_and_copy(name, groups):
    metrics = MetricCollection({"a": made(name)}, prefix="val/", postfix="/x", compute_groups=groups)
    other = metrics.clone(prefix="test/")
    for seed in range(2):
        metrics.update(*batch(name, seed))
    expected = counted(name, 0, 1).compute()
    same(metrics.compute(), {f"val/{key}/x": value for key, value in expected.items()})
    found = other(*batch(name))
    same(found, {f"test/{key}/x": value for key, value in counted(name, 0).compute().items()})
    for twin in (pickle.loads(pickle.dumps(metrics)), copy.deepcopy(metrics)):
        same(twin.compute(), metrics.compute())
    metrics.reset()
    metrics.update(*batch(name, 2))
    assert metrics.compute()[f"val/{KEYS[name]}/x"] == counted(name, 2).compute()[KEYS[name]]


def test_one_score_is_a_number_of_torchmetrics(name):
    """Arithmetic, trackers and bootstraps take numbers: `metric[key]` is the metric of one score."""
    key = KEYS[name]
    scores = [counted(name, seed).compute()[key] for seed in range(2)]
    combined = made(name)[key] + 2 * made(name)[key]
    combined.update(*batch(name))
    assert combined.compute() == pytest.approx(3 * scores[0].item())
    for tracked in (made(name)[key], MetricCollection([made(name)])):
        tracker = MetricTracker(tracked, maximize=True)
        for seed in range(2):
            tracker.increment()
            tracker.update(*batch(name, seed))
        best, step = tracker.best_metric(return_step=True)
        best, step = (best, step) if isinstance(best, float) else (best[key], step[key])
        assert (best, step) == (max(scores), int(scores[1] > scores[0]))
    bootstrap = BootStrapper(made(name)[key], num_bootstraps=3, raw=True)
    bootstrap.update(*batch(name))
    assert bootstrap.compute()["raw"].shape == (3,)


def test_nothing_counted_is_nan_with_a_warning(name):
    metric = made(name)
    with pytest.warns(UserWarning, match="was called before the ``update``"):
        found = metric.compute()
    assert found.keys() == counted(name, 0).compute().keys()
    assert all(value.isnan() for value in found.values())
    metric.reset()
    metric.update(*(part[:0] for part in batch(name)))
    same(metric.compute(), found)
    metric.update(*batch(name))
    same(metric.compute(), counted(name, 0).compute())


def test_updates_after_a_reset_in_inference_mode(name):
    metric = made(name)
    with torch.inference_mode():
        metric.update(*batch(name))
        metric.reset()
        metric.update(*batch(name, 0))
    metric.update(*batch(name, 1))
    same(metric.compute(), counted(name, 0, 1).compute())
    with torch.inference_mode():
        same(metric(*batch(name, 2)), counted(name, 2).compute())
    same(metric.compute(), counted(name, 0, 1, 2).compute())


def test_results_without_cache(name):
    metric = made(name, compute_with_cache=False)
    for seed in range(2):
        metric.update(*batch(name, seed))
        same(metric.compute(), counted(name, *range(seed + 1)).compute())


def test_unknown_truth_alone_counts_nothing():
    preds = batch("voxels")[0]
    for metric in (RayIoU(GRID), VoxelIoU(), VoxelIoU(grid=GRID), CandidateScores(GRID)):
        given = preds > 0 if isinstance(metric, CandidateScores) else preds
        metric.update(given, torch.full_like(preds, 255))
        found = metric.compute()
        assert all(value.isnan() for key, value in found.items() if not key.startswith("fraction"))


def test_the_protocol_follows_the_counts():
    preds, target = batch("rays")
    metrics = {"rays": RayIoU(GRID), "more": RayIoU(GRID), "voxels": VoxelIoU(), "cells": VoxelIoU()}
    metrics = MetricCollection(metrics)
    metrics.update(preds=preds, target=target)
    metrics.update(preds=preds, target=target, observed=target < 5)
    assert len(metrics.compute_groups) == 2
    for metric in metrics.values():
        assert "observed" in metric.protocol()
        new = metric.clone()
        new.reset()
        assert "observed" not in new.protocol()
        metric.persistent(True)
        saved = metric.state_dict()
        new.load_state_dict(saved)
        assert new.protocol() == metric.protocol()
        new.reset()
        new.update(preds, target)
        new.merge_state(metric)
        assert new.protocol() == metric.protocol()
        forward = metric.clone()
        forward.reset()
        forward(preds, target, observed=target < 5)
        forward(preds, target)
        assert forward.protocol() == metric.protocol()


def test_fractions_of_measured_rays_that_do_not_count():
    """Of four rays one counts, one is unknown, one has no return and one a point outside of the grid; one fills up."""
    inf = torch.inf
    ranges, labels = torch.tensor([[4.5, 5.5, inf, 12.0, inf]]), torch.tensor([[4, 255, 0, 4, 255]])
    directions = FORWARD.expand(1, 5, 3)
    preds = torch.zeros(1, *LINE.shape, dtype=torch.uint8)
    metric = RayIoU(LINE, directions=FORWARD)
    assert all(value.isnan() for value in metric.left_out().values())
    metric.update(preds, RayTruth(ranges, labels, directions))
    assert metric.truth.sum() == 1
    assert metric.left_out() == {"left_out": 0.75, "left_out_unknown": 0.25, "left_out_free": 0.5}
    metric.update(preds, preds)  # rays against voxels are not measured
    assert metric.left_out()["left_out"] == 0.75
    other = RayIoU(LINE, directions=FORWARD)
    other.update_rays(preds, torch.tensor([[2.5]]), torch.tensor([[4]]))
    gathered(metric, other)
    assert metric.left_out()["left_out"] == pytest.approx(0.6)
    assert metric._is_synced
    metric.unsync()
    metric.reset()
    assert metric.left_out()["left_out"].isnan()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning")
@pytest.mark.parametrize("precision", ["16-true", "bf16-mixed"])
@pytest.mark.parametrize("name", ["rays"], indirect=True)
def test_one_score_is_logged_as_an_object(name, precision):
    from lightning.pytorch import LightningModule, Trainer
    from torch.utils.data import DataLoader

    class Task(LightningModule):
        def __init__(self):
            super().__init__()
            self.metric = made(name)
            self.score = self.metric[KEYS[name]]

        def validation_step(self, given, index):
            self.score.update(*given)
            self.log("score", self.score)

        def configure_optimizers(self):
            return None

    options = {"logger": False, "enable_progress_bar": False, "enable_checkpointing": False}
    trainer = Trainer(accelerator="cpu", precision=precision, enable_model_summary=False, **options)
    loader = DataLoader([batch(name, seed) for seed in range(2)], batch_size=None)
    (logged,) = trainer.validate(Task(), loader, verbose=False)
    assert logged["score"] == counted(name, 0, 1).compute()[KEYS[name]]
    assert not counted(name, 0, 1).compute()[KEYS[name]].isnan()


def test_every_metric_has_a_plot(name):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    metric = counted(name, 0)
    figure, axes = metric.plot()
    assert metric.plot(ax=axes)[0] is figure
    _, bars = metric.plot(metric.compute())
    assert bars.patches
    _, lines = metric.plot([metric.compute(), metric.compute()])
    assert lines.lines
    made(name).plot(made(name).compute())
    made(name).plot()
    matplotlib.pyplot.close("all")


def test_scripts_and_hashes(name):
    torch.jit.script(made(name))
    one, two = counted(name, 0), counted(name, 0)
    assert hash(one) == hash(one) != hash(two)


def test_grids_in_float_and_int_are_one_setting():
    RayIoU(Cuboid((10, 1, 1), (0, 10), (-1, 1), (-1, 1))).merge_state(
        RayIoU(Cuboid((10, 1, 1), (0.0, 10.0), (-1.0, 1.0), (-1.0, 1.0)))
    )
