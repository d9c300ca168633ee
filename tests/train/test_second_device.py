"""Everything that runs on a GPU keeps its tensors there: tried on a simulated second device."""

from pathlib import Path

import numpy as np
import pytest
import torch
from batches import BESIDE, RIG, WAYS, always, make_batch
from second_device import MixedDevicesError, SecondDevice, tagged
from torch import nn

from omniocc.batch import Batch, to_device
from omniocc.config import build
from omniocc.data import RangeCache
from omniocc.export.program import make_module
from omniocc.model.ops.static import static_shapes
from omniocc.predict.predictor import Input, Predictor, predict_depth
from omniocc.predict.stopwatch import Stopwatch
from omniocc.train.depth import DepthTask
from omniocc.train.every_frame import FrameOutputs
from omniocc.train.sketch import rays_of
from omniocc.train.stage_task import step_generator
from omniocc.train.stages import predict_range_m

MODEL = Path(__file__).parents[2] / "conf" / "model"
CUDA = torch.device("cuda", 0)
pytestmark = pytest.mark.whole_runs
SLOTS = ("backbone", "geometry", "lifter", "sketch", "temporal", "refiner", "semantic_head", "hints")
NAMES = [f"model/{slot}={path.stem}" for slot in SLOTS for path in sorted((MODEL / slot).glob("*.yaml"))]
OPTIONS = [f"{name} {BESIDE.get(name, '')}".strip() for name in NAMES]
DEPTHS = [path.stem for path in sorted((MODEL / "depth").glob("*.yaml"))]


@pytest.fixture
def device():
    with SecondDevice() as device:
        yield device


def on_device(task, samples) -> Batch:
    batch = make_batch(task, samples)
    ranges = torch.rand(len(samples), 6, 36, 64) * 30
    return to_device(batch._replace(camera_range_m=ranges), CUDA)


def train_and_test(task, samples=((0, 1), (1, 2))) -> None:
    """Make a step of training with random changes of the images, then score a batch frame by frame."""
    task.to(CUDA)
    batch = task.augment(on_device(task, samples), step_generator(task, task.config["seed"], 0))
    prediction = task.predict(batch)
    terms = task.loss(prediction, batch.voxels, batch.pixel_labels)
    terms |= task.loss.ray_terms(prediction.logits, rays_of(batch), step_generator(task, 0, 0))
    torch.stack(list(terms.values())).sum().backward()
    grads = [parameter.grad for parameter in task.model.parameters() if parameter.requires_grad]
    assert all(tagged(grad) for grad in grads)
    task.eval()
    task.validation_step(on_device(task, samples), 0)
    assert all(torch.isfinite(value) or value.isnan() for value in task.scores.compute().values())


@pytest.mark.parametrize(
    "option", [*OPTIONS, "loss=with_ranges model=bevdet", "loss=with_first_hits", "loss=lidar_rays", "model=extended"]
)
def test_every_option_trains_and_is_scored_there(option, make_task, device):
    sketch = [] if option.startswith(("model/sketch", "model=extended")) else ["model/sketch=dense"]
    task = make_task(*sketch, *option.split())
    task.set_training_statistics(torch.randint(1, 100, (12, *task.model.geometry.shape)))
    train_and_test(task)


@pytest.mark.parametrize("way", WAYS)
def test_disturbed_batches_stay_there(way, make_task, device):
    task = make_task("model=extended", "augment=disturbed", *always(way))
    task.set_training_statistics(torch.randint(1, 100, (12, *task.model.geometry.shape)))
    train_and_test(task)


@pytest.mark.parametrize("name", DEPTHS)
def test_every_depth_option_predicts_there_and_learned_ones_train(name, smoke, device):
    cfg = smoke("model/sketch=omni", f"model/depth={name}")
    model = build(cfg.depth).to(CUDA)
    images, range_m = torch.rand(1, 6, 3, 36, 64, device=CUDA), torch.rand(1, 12, 48, device=CUDA) * 30
    camera_range_m = torch.rand(1, 6, 36, 64, device=CUDA) * 30
    found = model(images, (RIG,), range_m)
    assert all(tagged(part) for part in (found.range_m, found.index, found.valid, found.confidence))
    if hasattr(model, "weighted_losses"):
        terms = model.weighted_losses(images, (RIG,), range_m, camera_range_m, torch.Generator())
        torch.stack(list(terms.values())).sum().backward()
        assert all(tagged(p.grad) for p in model.parameters() if p.grad is not None)
    if not model.NEEDS_TRUE_RANGE:
        assert predict_depth(model, images.cpu(), RIG, CUDA).range_m.isfinite().any()


@pytest.mark.parametrize(
    ("slot", "mistake"),
    [("backbone", "an output on the CPU"), ("lifter", "an operand on the CPU"), ("refiner", "numpy")],
)
def test_a_mistake_in_a_slot_is_found(slot, mistake, make_task, device, monkeypatch):
    task = make_task("model/sketch=dense")
    module = getattr(task.model, slot)
    right = type(module).forward

    def wrong(self, *arguments):
        found = right(self, *arguments)
        first = found[0] if isinstance(found, list) else found
        if mistake == "numpy":
            first = first + float(first.detach().numpy().sum())
        else:
            first = first.cpu() if mistake.startswith("an output") else first + torch.ones(first.shape)
        return [first] if isinstance(found, list) else first

    monkeypatch.setattr(type(module), "forward", wrong)
    with pytest.raises(MixedDevicesError):
        train_and_test(task)


def test_operands_that_a_gpu_accepts_too(device):
    there = torch.arange(6.0, device=CUDA).reshape(2, 3)
    assert tagged(there * torch.tensor(2.0))
    assert tagged(there[torch.tensor([1])])
    assert (there.device, there.cpu().device) == (CUDA, torch.device("cpu"))
    assert tagged(nn.Linear(3, 2).to(CUDA)(there))
    with pytest.raises(MixedDevicesError):
        there + torch.ones(2, 3)
    with pytest.raises(MixedDevicesError):
        there.numpy()


def test_prediction_with_a_learned_sketch_returns_results_on_the_cpu(make_task, device, monkeypatch):
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: None)
    model = make_task("model/sketch=omni").model.eval()
    predictor = Predictor(model, None, ("rear",), CUDA)
    images = [np.full((36, 64, 3), 40 * camera, np.uint8) for camera in range(6)]
    for frame in range(2):
        pose = torch.eye(4, dtype=torch.float64)
        pose[0, 3] = frame
        given = Input(*predictor.scaled(images, RIG), pose)
        found = predictor.step(given, Stopwatch(CUDA, ("depth", "sketch", "occupancy")))
        assert not any(tagged(part) for part in (found.labels, found.candidates, found.range_m))


def test_the_module_that_is_exported_runs_there(make_task, device):
    module = make_module(make_task("model/sketch=omni", "model/temporal=none").model.to(CUDA), RIG)
    images = torch.randint(0, 256, (6, 3, 36, 64), dtype=torch.uint8, device=CUDA)
    assert tagged(module(images))
    with static_shapes():
        assert tagged(module(images))


class Scene:
    name, rigs = "street", (RIG, RIG)

    def __len__(self):
        return 2


def test_predictions_for_all_frames_are_made_where_training_was(smoke, tmp_path, device):
    cfg = smoke("model/sketch=omni")
    task = DepthTask(
        build(cfg.depth), build(cfg.stages.depth).optimizer, build(cfg.depth).rig_spheres(RIG), (0.0, 9.0), 0, {}
    )
    cache, scene, seen = RangeCache(tmp_path, (12, 48)), Scene(), []

    def predict(task, rig, images, true_range_m):
        seen.append((tagged(images), true_range_m))
        return predict_range_m(task, rig, images, true_range_m)

    def read(scene, frame):
        return torch.randint(0, 256, (6, 3, 36, 64), dtype=torch.uint8), None

    outputs = FrameOutputs("ranges", [scene], [cache], read, predict)
    assert outputs.missing() == [scene]
    outputs.fill([scene], task, CUDA, 0, "depth")
    assert seen == [(True, None)] * 2
    assert outputs.missing() == []
    assert cache.read(scene, 1).isfinite().any()
    assert not any(tagged(parameter) for parameter in task.parameters())
