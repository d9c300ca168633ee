"""Training on measured rays: without voxel labels, from votes, and what the stages read for it."""

from types import SimpleNamespace

import pytest
import torch
from batches import RIG, make_batch

from omniocc.data import OccupancyData
from omniocc.errors import UserError
from omniocc.loss import RayWindow
from omniocc.parts import Parts
from omniocc.train.stages import stages_of

pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]
GEOMETRY = ("model/sketch=dense", "model/semantic_head=none", "loss=lidar_rays")


def test_a_step_on_rays_needs_no_voxel_labels(make_task):
    task = make_task(*GEOMETRY)
    batch = make_batch(task, [(0, 1), (1, 2)])._replace(voxels=None, pixel_labels=None)
    task.training_step(batch, 0).backward()
    assert task.model.classifier.linear.weight.grad.abs().sum() > 0
    other = task.training_step(batch._replace(scan_labels=torch.full_like(batch.scan_labels, 255)), 0)
    assert torch.isfinite(other)


def test_frames_without_scans_end_in_one_line(make_task):
    task = make_task(*GEOMETRY)
    batch = make_batch(task, [(0, 1), (1, 2)])._replace(scan_origins=None, scan_ends=None, scan_labels=None)
    with pytest.raises(UserError, match="loss=lidar_rays needs LiDAR scans") as caught:
        task.training_step(batch, 0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("loss", ["lidar_rays", "voted_rays", "paper"])
def test_the_stages_read_what_the_loss_learns_from(loss, smoke, monkeypatch, tmp_path):
    windows = []
    monkeypatch.setattr(OccupancyData, "ray_votes", lambda data, window: windows.append(window) or window)
    places = [f"paths.data={tmp_path}", f"paths.runs={tmp_path}"]
    parts = Parts(smoke("model/sketch=omni", f"loss={loss}", *places))
    _, sketch, occupancy = stages_of(parts, parts.data())
    of_sketch, of_test = sketch.needs(sketch.task(RIG))
    training, test = occupancy.needs(occupancy.task(RIG))
    assert of_test.votes is of_test.rays is test.votes is test.rays is None
    assert (of_test.voxels, test.voxels) == (True, True)
    assert training.voxels == (loss != "lidar_rays")
    if loss == "paper":
        assert windows == []
        assert of_sketch.votes is training.votes is training.rays is None
        return
    window = RayWindow([0], True)
    assert of_sketch.voxels == training.voxels
    if loss == "voted_rays":
        assert (of_sketch.votes, training.votes) == (window, window)
        assert of_sketch.rays is training.rays is None
    else:
        assert of_sketch.votes is training.votes is None
        assert (of_sketch.rays, training.rays) == (window, window)


def test_the_sketch_learns_from_rays(smoke, losses):
    parts = Parts(smoke("model/sketch=omni", "loss=lidar_rays"))
    data = parts.data()
    sketch = stages_of(parts, data)[1].task(RIG)
    ends = 8 * torch.nn.functional.normalize(torch.randn(2, 500, 3), dim=-1)
    labels = torch.randint(1, 12, (2, 500), dtype=torch.uint8)  # of more classes than the sketch has
    batch = make_batch(shaped_as(data.geometry), [(0, 1), (1, 2)])._replace(
        voxels=None,
        depth_range_m=torch.full((2, 12, 48), 8.0),
        scan_origins=torch.zeros_like(ends),
        scan_ends=ends,
        scan_labels=labels,
    )
    values = losses(sketch, lambda: sketch.training_step(batch, 0))
    assert values[-1] < 0.8 * values[0]
    assert not any(key.startswith("loss.") for key in sketch.state_dict())


def shaped_as(geometry):
    model = SimpleNamespace(geometry=geometry, temporal=SimpleNamespace(frames=1))
    return SimpleNamespace(model=model)
