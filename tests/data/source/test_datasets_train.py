"""Every system trains and is tested on public datasets, in small copies of their layout."""

import copy
from collections.abc import Sequence

import pytest
import torch
from dataset_files import write_carlasc, write_woodscape
from kitti_files import write_kitti360, write_semantic_kitti, write_sscbench
from lightning.pytorch import Trainer, seed_everything
from made_scenes import write_checkpoint
from nuscenes_files import write_nuscenes

from omniocc.config import build, check_root
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.predict.submission import predict_submission
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.checkpoint_io import LAST
from omniocc.train.build import build_task, without_unused_head
from omniocc.train.data_module import DataModule
from omniocc.train.stages import DepthStage, SketchStage
from omniocc.train.submission import frames_of, score_files, write_files

pytestmark = [
    pytest.mark.whole_runs,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]
CUBOID = [
    "model/geometry=cuboid",
    "model.geometry.shape=[20,20,4]",
    "model.geometry.x_m=[-40.8,39.2]",
    "model.geometry.y_m=[-40,40]",
]


@pytest.fixture(scope="module")
def occ3d(tmp_path_factory):
    root = write_nuscenes(tmp_path_factory.mktemp("nuscenes"), frames=2)
    return ["data=occ3d_nuscenes", f"data.source.root={root}", "data.source.val_every=2"]


def train(cfg):
    """Train two steps and test; returns training logs, test figures, task and data."""
    check_root(cfg)
    seed_everything(0, verbose=False)
    data = build(cfg.data)
    data.prepare_data()
    parts, _ = without_unused_head(Parts(cfg), data.source.scenes("train"))
    data.setup()
    task = build_task(parts, data.source.spec)
    task.set_training_statistics(data.voxel_counts())
    trainer = Trainer(
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=False,
        num_sanity_val_steps=0,
        max_steps=2,
    )
    trainer.fit(task, datamodule=DataModule(data))
    logged = dict(trainer.logged_metrics)
    return logged, trainer.test(task, datamodule=DataModule(data), verbose=False)[0], task, data


@pytest.mark.parametrize(
    "system",
    [
        ["model=bevformer", *CUBOID],
        ["model=bevdet", *CUBOID],
        ["model=voxformer", *CUBOID],
        ["model=extended"],
        ["model/sketch=mono"],
        ["model/sketch=random"],
        ["model/sketch=dense", "data.ignore=unseen"],
    ],
    ids=" ".join,
)
def test_every_system_runs_on_occ3d(smoke, occ3d, system):
    logged, figures, *_ = train(smoke(*system, *occ3d, "logger.mode=disabled"))
    assert all(torch.isfinite(value) for key, value in logged.items() if key.startswith("train/"))
    assert 0 <= figures["test/rayiou"] <= 1
    assert figures["label/rayiou"] > 0
    assert {"test/rayiou/driveable_surface", "test/rayiou_0-20m", "test/voxel/miou", "prior/voxel/iou"} <= set(figures)


@pytest.fixture(scope="module")
def kitti(tmp_path_factory):
    root = write_semantic_kitti(tmp_path_factory.mktemp("kitti"), frames=2)
    return [
        "data=semantic_kitti",
        f"data.source.root={root}",
        "data.source.sequences={train:['00'],val:['04'],test:['08']}",
    ]


@pytest.fixture(scope="module")
def sscbench(tmp_path_factory):
    root = write_sscbench(tmp_path_factory.mktemp("sscbench"))
    other = write_kitti360(tmp_path_factory.mktemp("kitti360"))
    splits = "data.source.sequences={train:['00'],val:['06'],test:['09']}"
    return ["data=sscbench_kitti360", f"data.source.root={root}", f"data.source.kitti360={other}", splits]


AHEAD = ["model/geometry=cuboid", "model.geometry.shape=[16,16,4]", "model.geometry.x_m=[0,51.2]"]


@pytest.mark.parametrize(
    ("dataset", "system"),
    [
        ("kitti", ["model=extended"]),
        ("kitti", ["model=voxformer", *AHEAD]),
        ("kitti", ["model/sketch=mono"]),
        ("sscbench", ["model=extended"]),
    ],
    ids=str,
)
def test_systems_run_ahead_of_the_car(smoke, request, dataset, system):
    logged, figures, *_ = train(smoke(*system, *request.getfixturevalue(dataset), "logger.mode=disabled"))
    assert all(torch.isfinite(value) for key, value in logged.items() if key.startswith("train/"))
    assert {"test/rayiou/road", "test/voxel_12.8m/miou", "test/voxel/iou/car"} <= set(figures)
    assert figures["label/voxel/iou"] > 0.2
    with_head = dataset == "kitti" and system[0] != "model=voxformer"
    assert ("train/loss/semantics" in logged) == with_head  # classes of pixels come from the labels of points


@pytest.fixture(scope="module")
def depth_of_kitti360(smoke, tmp_path_factory):
    """Return a function that makes the stages which learn depth from scans, of a changed recipe."""
    folder = tmp_path_factory.mktemp("raw")
    cfg = smoke(
        "data=kitti360",
        f"data.source.root={write_kitti360(folder)}",
        "stage=depth",
        "data.source.accumulate=1",
        "data.source.sequences={train:['00'],val:['06'],test:['09']}",
        "logger.mode=disabled",
        f"paths.runs={folder / 'runs'}",
    )
    check_root(cfg)
    data = build(cfg.data)
    data.prepare_data()

    def make(**recipe):
        changed = copy.deepcopy(cfg)
        changed.stages.depth.update(recipe)
        return DepthStage(Parts(changed), data)

    return make


def test_depth_learns_from_the_scans_of_kitti360(depth_of_kitti360):
    figures = depth_of_kitti360(max_steps=3).run("depth")
    assert 0 < figures["test/depth/mae"] < 50


def test_the_first_weights_of_a_stage_follow_from_its_own_seed(depth_of_kitti360):
    stage = depth_of_kitti360(max_steps=0, seed=3)
    stage.run("depth")
    found = load_checkpoint(stage.folder / LAST).model_weights
    torch.manual_seed(3)
    expected = stage.parts.depth().state_dict()
    assert all(torch.equal(found[name], value) for name, value in expected.items())


def test_depth_without_true_ranges_is_one_clear_line(smoke, tmp_path):
    root = write_sscbench(tmp_path)
    splits = "data.source.sequences={train:['00'],val:['06'],test:['09']}"
    cfg = smoke("data=sscbench_kitti360", f"data.source.root={root}", splits, f"paths.runs={tmp_path / 'runs'}")
    data = build(cfg.data)
    data.prepare_data()
    with pytest.raises(UserError, match="the training frames have no true ranges, from which depth learns: choose a"):
        DepthStage(Parts(cfg), data).run("depth")


def test_the_2d_head_learns_from_woodscape(smoke, tmp_path_factory):
    root = write_woodscape(tmp_path_factory.mktemp("woodscape"))
    logged, figures, *_ = train(
        smoke("data=woodscape", f"data.source.root={root}", "model/sketch=dense", "logger.mode=disabled")
    )
    assert torch.isfinite(logged["train/loss/semantics"])
    assert "train/loss/ce" not in logged
    assert not [key for key in figures if "rayiou" in key]


def test_a_sketch_learns_from_the_true_ranges_of_carlasc(smoke, tmp_path_factory):
    root = write_carlasc(tmp_path_factory.mktemp("carlasc"), frames=2)
    cfg = smoke(
        "data=carlasc",
        f"data.source.root={root}",
        "stage=sketch",
        "model/depth=truth",
        "logger.mode=disabled",
        f"paths.runs={root / 'runs'}",
        "stages.sketch.max_steps=3",
    )
    check_root(cfg)
    data = build(cfg.data)
    data.prepare_data()
    depth = DepthStage(Parts(cfg), data, has_reader=True)
    depth.run("depth")
    figures = SketchStage(Parts(cfg), data, [depth]).run("sketch")
    assert 0 <= figures["test/sketch/recall"] <= 1


def test_without_classes_of_pixels_the_2d_head_is_off(smoke, occ3d, kitti):
    cfg = smoke("model=extended", *occ3d)
    data = build(cfg.data)
    data.prepare_data()
    parts, line = without_unused_head(Parts(cfg), data.source.scenes("train"))
    assert line.startswith("the training frames have no classes of pixels, so the 2D head is left out: model/semantic")
    model = build_task(parts, data.source.spec).model
    assert model.hints.classes is None
    assert not list(model.semantic_head.parameters())
    assert cfg.model.hints.pixel_classes, "the configuration that was given is as it was"
    assert without_unused_head(parts, data.source.scenes("train")) == (parts, None)
    with_classes = Parts(smoke("model=extended", *kitti))
    assert without_unused_head(with_classes, with_classes.source().scenes("train")) == (with_classes, None)
    assert without_unused_head(with_classes, []) == (with_classes, None)


def test_predictions_written_as_files_get_the_scores_of_the_test(smoke, occ3d, tmp_path):
    _, figures, task, data = train(smoke("model/sketch=dense", *occ3d, "logger.mode=disabled"))
    device = torch.device("cpu")
    frames = frames_of(data.source, "test")
    assert write_files(task, data, frames, tmp_path, "test", device) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene-0003-0.npz", "scene-0003-1.npz"]
    scores, protocol = score_files(data.source, tmp_path)
    assert protocol == task.protocol
    assert "at most 2 origins a frame (where the car was in past, present and future frames)" in protocol["rayiou"]
    assert scores["test/rayiou"] > 0
    for key, value in scores.items():
        assert value == pytest.approx(figures[key], abs=1e-6, nan_ok=True)
    (tmp_path / "scene-0003-0.npz").write_bytes(b"kept")
    write_files(
        task, data, frames_of(data.source, "test"), tmp_path, "test", device
    )  # what is there is not predicted again
    assert (tmp_path / "scene-0003-0.npz").read_bytes() == b"kept"
    with pytest.raises(UserError, match="split=all: choose train, val, test"):
        frames_of(data.source, "all")


def test_files_of_one_folder_are_of_one_checkpoint_split_and_dataset(smoke, occ3d, tmp_path):
    cfg = smoke("model/sketch=dense", *occ3d)
    path, output = write_checkpoint(tmp_path / "best.ckpt", cfg, build(cfg.data).spec), tmp_path / "out"

    def predict(split: str = "test", force: bool = False, changes: Sequence[str] = ()) -> None:
        predict_submission(str(path), output, split, changes, "cpu", force)

    predict()
    first = {file.name: file.stat().st_mtime_ns for file in output.glob("*.npz")}
    predict()
    assert len(first) == 2
    assert {file.name: file.stat().st_mtime_ns for file in output.glob("*.npz")} == first
    with pytest.raises(UserError, match=r"made with split=test \(now val\)"):
        predict("val")
    with pytest.raises(UserError, match=r"made with other data, changes=\[\] \(now "):
        predict(changes=["data.source.val_every=3"])
    predict("val", force=True)
    assert not first.keys() & {file.name for file in output.glob("*.npz")}
