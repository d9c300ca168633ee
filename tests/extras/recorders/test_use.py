"""What an imported scene serves: predict.py without labels, depth from the ranges of a LiDAR, voxels."""

import shutil

import numpy as np
import pytest
import torch
from log_files import lidar_option
from made_scenes import write_checkpoint

from omniocc.config import build, check_root, plain
from omniocc.data import DataError, Needs, SceneReader
from omniocc.parts import Parts
from omniocc.predict import load
from omniocc.predict.occupancy import options_of, predict_occupancy
from omniocc.train.build import build_task, without_unused_head
from omniocc.train.depth import DepthTask

pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


def test_a_scene_without_labels_is_predicted(recorder, composed, smoke, spec, tmp_path, capsys):
    (folder,) = recorder().record(tmp_path)
    checkpoint = write_checkpoint(tmp_path / "best.ckpt", smoke(), spec)
    given = (f"checkpoint={checkpoint}", f"recorded={folder}", f"output={tmp_path / 'out'}", "mesh=false")
    predict_occupancy(options_of(composed(*given, name="predict_occupancy")))
    labels = np.load(tmp_path / "out" / folder.name / "000001" / "voxels.npz")["labels"]
    assert labels.shape == load(checkpoint).occupancy.geometry.shape
    assert not (tmp_path / "out" / "metrics.json").exists()  # nothing to compare with
    assert "history   stream" in capsys.readouterr().out  # poses are known


def data_of(smoke, root, classes):
    splits, number = "data.source.splits={train: [train-*], val: [], test: []}", f"data.num_classes={classes}"
    cfg = smoke("data=recorded", f"data.source.root={root}", number, "data.source.workers=0", splits)
    check_root(cfg)
    return cfg, build(cfg.data)


def test_depth_learns_from_the_ranges_of_a_lidar(recorder, smoke, tmp_path):
    # another road, so another rig: matrices of one that was predicted in this process cannot be trained with
    recorder(lidar_option("npz"), "road_z_m=-2.0").record(tmp_path)
    cfg, data = data_of(smoke, tmp_path, classes=2)
    data.prepare_data()
    assert "no classes of pixels" in str(without_unused_head(Parts(cfg), data.source.scenes("train"))[1])
    data.set_needs(data.needs["train"]._replace(panorama=True, camera_ranges=True), data.needs["test"])
    data.setup()
    batch = next(iter(data.train_dataloader()))
    assert batch.erp_range_m.shape[1:] == (12, 48)  # of the preset; 180x720 px were recorded
    assert set(batch.voxels.unique().tolist()) == {0, 1}
    model = build(cfg.depth)
    recipe = build(cfg.stages.depth)
    spheres = model.rig_spheres(batch.rigs[0][0])
    task = DepthTask(model, recipe.optimizer, spheres, data.source.spec.range_edges_m, 0, plain(cfg), appearance=None)
    loss = task.training_step(batch, 0)
    loss.backward()
    assert torch.isfinite(loss)
    assert any(float(part.grad.abs().sum()) > 0 for part in model.parameters() if part.grad is not None)


def test_the_geometry_alone_learns_from_rays_without_classes(recorder, smoke, losses, tmp_path):
    recorder(lidar_option("npz")).record(tmp_path)
    _, data = data_of(smoke, tmp_path, classes=2)
    data.prepare_data()
    cfg = smoke("loss=lidar_rays", "loss.rays.frames=[0,-1,1]", "model/sketch=dense", "model.num_classes=2")
    task = build_task(Parts(cfg).without_head(), data.spec)
    data.set_needs(Needs(voxels=False, scores=False, rays=task.loss.rays), Needs())
    data.setup()
    counts = data.voxel_counts(task.loss)
    assert counts.flatten(1).sum(1).min() > 0
    task.set_training_statistics(counts)
    batch = next(iter(data.train_dataloader()))
    assert batch.voxels is None
    assert set(batch.scan_labels.unique().tolist()) <= {1, 255}
    values = losses(task.model, lambda: task.training_step(batch, 0))
    assert values[-1] < 0.9 * values[0]


def test_training_without_points_ends_in_one_line(recorder, smoke, tmp_path):
    recorder().record(tmp_path)
    _, data = data_of(smoke, tmp_path, classes=2)
    with pytest.raises(DataError) as caught:
        data.prepare_data()
    assert "no points are recorded, so no voxels can be voted" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_page_of_scenes_without_labels(original, recorder, tmp_path):
    """The page shows what there is; facts of the virtual world are of its own scenes."""
    from omniocc.classes import WORLD_CLASSES
    from omniocc.geometry import Cylinder
    from omniworld.page import _frame

    scene = SceneReader(recorder().record(tmp_path)[0])
    drawn = _frame(scene, 0, Cylinder(), WORLD_CLASSES)
    assert len(drawn["rgb"]) == len(original.rig.names)
    assert drawn["semantic"] == drawn["range"] == []
    assert drawn["panorama"] == drawn["voxels"] == drawn["bev"] == ""
    shutil.rmtree(tmp_path)
