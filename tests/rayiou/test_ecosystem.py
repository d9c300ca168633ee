"""Our metrics among those of torchmetrics: what its own tester checks, and names, arguments and plots of its kind.

The tester is in the repository of torchmetrics, not in its package: `MetricTester.run_class_metric_test` of
`tests/unittests/_helpers/testers.py`. Two processes are in `test_ray_metric.py`.
"""

import inspect
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from metric_batches import FORWARD, GRID, LINE, METRICS, batch, made, same
from torchmetrics import MetricCollection

import rayiou
from omniocc.geometry import Cuboid
from omniocc.metric import CandidateScores, DepthMetrics, RayIoU, VoxelIoU, ray_iou


@pytest.fixture(params=METRICS)
def name(request):
    return request.param


def test_the_keyword_arguments_of_every_metric(name):
    metric = made(name, dist_sync_on_step=True, sync_on_compute=False, compute_on_cpu=True, compute_with_cache=False)
    assert (metric.dist_sync_on_step, metric.sync_on_compute, metric.compute_on_cpu) == (True, False, True)
    metric.update(*batch(name))
    assert metric._computed is None
    with pytest.raises(ValueError, match="Unexpected keyword arguments: `threshold`"):
        made(name, threshold=1)


@pytest.mark.parametrize("on_step", [True, False])
def test_forward_is_update_and_compute(name, on_step):
    metric, alone = made(name, dist_sync_on_step=on_step), made(name)
    for seed in range(3):
        value = metric(*batch(name, seed))
        alone.reset()
        alone.update(*batch(name, seed))
        same(value, alone.compute())
    whole = made(name)
    for seed in range(3):
        whole.update(*batch(name, seed))
    same(metric.compute(), whole.compute())
    assert (metric.update_count, whole.update_count) == (3, 3)


def test_reset_gives_a_new_metric(name):
    metric, new = made(name), made(name)
    metric.update(*batch(name))
    metric.reset()
    assert metric.metric_state.keys() == new.metric_state.keys()
    assert all(torch.equal(metric.metric_state[key], value) for key, value in new.metric_state.items())
    assert metric.update_count == 0


def test_copies_hold_what_was_counted(name):
    metric = made(name)
    metric.update(*batch(name))
    for twin in (pickle.loads(pickle.dumps(metric)), metric.clone()):
        assert type(twin) is type(metric)
        same(twin.compute(), metric.compute())
        twin.update(*batch(name, 1))
        assert twin.update_count == 2
    assert metric.state_dict() == {}
    assert hash(metric) != hash(made(name))


def test_facts_of_the_class_do_not_change(name):
    metric = made(name)
    for fact in ("is_differentiable", "higher_is_better"):
        with pytest.raises(RuntimeError):
            setattr(metric, fact, not getattr(metric, fact))


def test_predictions_and_truth_have_the_names_of_the_ecosystem(name):
    by_name, by_place = made(name), made(name)
    preds, target = batch(name)
    by_name.update(preds=preds, target=target)
    by_place.update(preds, target)
    same(by_name.compute(), by_place.compute())
    assert list(inspect.signature(METRICS[name][0].update).parameters)[1:3] == ["preds", "target"]


def test_a_collection_hands_over_by_name():
    preds, target = batch("rays")
    observed = torch.rand(target.shape, generator=torch.Generator().manual_seed(2)) < 0.5
    metrics = MetricCollection({"rays": RayIoU(GRID), "voxels": VoxelIoU()})
    for _ in range(2):  # the second time, as groups of equal states
        metrics.update(preds=preds, target=target, observed=observed, images=torch.zeros(1))
    expected = VoxelIoU()
    expected.update(preds, target, observed)
    found = metrics.compute()
    assert found["miou"] == expected.compute()["miou"]
    assert found["rayiou"] == ray_iou(preds, target, GRID, observed=observed)["rayiou"]


def test_a_collection_never_merges_metrics_of_other_settings():
    """torchmetrics shares the states of metrics whose first batch gave equal ones, here by chance."""
    wide = Cuboid((5, 1, 1), (0.0, 10.0), (-0.5, 0.5), (-0.5, 0.5))
    target = torch.zeros(1, 5, 1, 1, dtype=torch.uint8)
    target[0, 1] = 4  # 2 to 4 m
    preds = torch.zeros(1, 10, 1, 1, dtype=torch.uint8)
    kinds = {
        hit: RayIoU(LINE, directions=FORWARD, target_grid=wide, thresholds_m=(0.5,), hit=hit)
        for hit in ("exit", "entry")
    }
    metrics = MetricCollection({**kinds, "again": kinds["exit"].clone()})
    metrics.update(preds, target)  # nothing is found in either way
    preds[0, 2] = 4
    metrics.update(preds, target)  # entered at 2 m as the true cell, left at 3 m and not at 4 m
    assert metrics["exit"].compute()["rayiou"] == 0.0
    assert metrics["entry"].compute()["rayiou"] == 0.5
    assert sorted(map(sorted, metrics.compute_groups.values())) == [["again", "exit"], ["entry"]]


def test_bands_that_are_equal_by_chance_stay_apart():
    """In the first batch everything is in the nearest band of both."""
    near, far = torch.tensor([4.0]), torch.tensor([12.0])
    depth = {edge: DepthMetrics(1.0, 50.0, range_edges_m=(0.0, edge, 20.0)) for edge in (10.0, 15.0)}
    metrics = MetricCollection({f"{edge:g}": metric for edge, metric in depth.items()})
    metrics.update(near + 1, near)
    metrics.update(far + 2, far)
    assert metrics["10"].compute()["mae_0-10m"] == pytest.approx(1.0)
    assert metrics["15"].compute()["mae_0-15m"] == pytest.approx(1.5)
    wide = MetricCollection({f"to_{edge}_m": CandidateScores(LINE, (0, edge, 20)) for edge in (2, 3)})
    assert len({tuple(metric.setting.tolist()) for metric in wide.values()}) == 2


def test_bounds_of_plots(name):
    metric = made(name)
    assert metric.plot_lower_bound == 0.0
    assert metric.plot_upper_bound == (None if name == "depth" else 1.0)
    assert metric.higher_is_better is {"depth": False, "calibration": False, "candidates": None}.get(name, True)


@pytest.mark.parametrize("name", ["rays", "voxels", "candidates"], indirect=True)
def test_results_of_several_steps_are_lines(name):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    metric = made(name)
    steps = [metric(*batch(name, seed)) for seed in range(3)]
    figure, axes = metric.plot(steps)
    lines = {line.get_label(): line.get_ydata() for line in axes.lines}
    key = {"rays": "rayiou/1", "voxels": "iou/1", "candidates": "recall"}[name]
    assert list(lines[key]) == pytest.approx([float(step[key]) for step in steps])
    low, high = axes.get_ylim()
    assert low < 0 < 1 < high
    assert metric.plot(steps, axes)[0] is figure
    matplotlib.pyplot.close(figure)


HEAVY = (
    "lightning",
    "pytorch_lightning",
    "hydra",
    "omegaconf",
    "wandb",
    "transformers",
    "embreex",
    "cv2",
    "scipy",
    "PIL",
    "jinja2",
    "rich",
    "safetensors",
    "fsspec",
    "zstandard",
    "yaml",
    "matplotlib",
)


def test_importing_the_metrics_is_light():
    code = (
        "import sys, numpy, torch, torchmetrics, numba, jaxtyping; before = set(sys.modules);"
        "import rayiou;"
        "print(*sorted({name.partition('.')[0] for name in set(sys.modules) - before}));"
        "print(*sorted(name for name in sys.modules if name.partition('.')[0] in ('omniocc', 'omniworld')))"
    )
    path = {"PYTHONPATH": str(Path(rayiou.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=path, capture_output=True, text=True, check=True)
    added, ours = (line.split() for line in done.stdout.splitlines())
    assert not set(HEAVY) & set(added)
    # beyond these: parts of the five packages that they load late
    assert set(added) - set(sys.stdlib_module_names) <= {"rayiou", "llvmlite", "numba", "jaxtyping", "torch", "numpy"}
    assert not ours
