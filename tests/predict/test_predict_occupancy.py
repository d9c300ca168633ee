"""`predict.py occupancy` on a random scene, compared with the labels of evaluate.py."""

import dataclasses
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from made_scenes import RIG, write_checkpoint, write_scene

from omniocc.camera import Rig
from omniocc.camera.masks import mask_cameras
from omniocc.classes import OCCUPANCY_CLASSES, UNKNOWN, ClassTable, SemanticClass
from omniocc.data import SceneReader, WindowDataset, collate
from omniocc.data.labels.voxels import VoxelCache
from omniocc.errors import UserError
from omniocc.predict import load
from omniocc.predict.export_scene import export_scene
from omniocc.predict.export_scene import main as export
from omniocc.predict.input.poses import read_poses, write_poses
from omniocc.predict.input.sequence import find_scenes
from omniocc.predict.occupancy import announcement, options_of, other_heights, predict_occupancy
from omniocc.runs.checkpoint import CONFIG, STAGE
from omniocc.scores import Scores

ROOT = Path(__file__).parents[2]
FRAMES = [f"{k:06d}" for k in range(5)]
MASKS = sorted(f"rig.{name}.png" for name in RIG.names)
QUICK = ("overview=false", "mesh=false")
pytestmark = [
    pytest.mark.filterwarnings("ignore:voxels are voted anew"),
    pytest.mark.filterwarnings("ignore:Sparse CSR"),
]


@pytest.fixture(scope="module")
def scene(tmp_path_factory, spec) -> Path:
    return write_scene(tmp_path_factory.mktemp("data") / "test-000-nowhere", spec, 0, len(FRAMES), RIG)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, smoke, spec) -> Path:
    """Return a checkpoint with random weights that predict many classes."""
    return write_checkpoint(tmp_path_factory.mktemp("run") / "best.ckpt", smoke(), spec)


@pytest.fixture(scope="module")
def evaluated(scene, checkpoint, spec):
    """Return the labels of every frame and the scores of `evaluate.py`."""
    task = load(checkpoint).task
    geometry = task.model.geometry
    data = WindowDataset([SceneReader(scene)], VoxelCache(scene.parent, geometry), task.model.temporal.frames)
    scores, labels = Scores(geometry, spec), []
    for k in range(len(data)):
        batch = collate([data[k]])
        labels.append(task.evaluate(batch)[0])
        scores.update(labels[-1][None], batch)
    return torch.stack(labels).numpy(), {f"test/{key}": float(value) for key, value in scores.compute().items()}


@pytest.fixture(scope="module")
def images(scene, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("images") / "sequence"
    export([str(scene), str(folder)])
    assert sorted(path.name for path in folder.iterdir()) == [*FRAMES, "poses.csv", *MASKS, "rig.yaml"]
    return folder


@pytest.fixture(scope="module")
def run(composed):
    def predict(*overrides) -> None:
        predict_occupancy(options_of(composed(*map(str, overrides), name="predict_occupancy")))

    return predict


def labels_in(folder: Path) -> np.ndarray:
    return np.stack([np.load(folder / name / "voxels.npz")["labels"] for name in FRAMES])


def source_of(images, checkpoint):
    return f"checkpoint={checkpoint}", f"images={images}", f"rig={images / 'rig.yaml'}"


def test_images_give_the_labels_of_evaluation(evaluated, images, checkpoint, tmp_path, capsys, run):
    expected, _ = evaluated
    assert len(np.unique(expected)) > 3  # otherwise equality would prove nothing
    source, poses = source_of(images, checkpoint), f"poses={images / 'poses.csv'}"
    run(*source, poses, *QUICK, f"output={tmp_path / 'stream'}")
    seen = np.stack([np.load(tmp_path / "stream" / frame / "voxels.npz")["seen"] for frame in FRAMES])
    assert 0.5 < seen.mean() < 1
    expected = np.where(seen, expected, UNKNOWN)
    assert np.array_equal(labels_in(tmp_path / "stream"), expected)
    assert "history   stream: up to 2 past frames" in capsys.readouterr().out
    run(*source, poses, *QUICK, f"output={tmp_path / 'window'}", "history=window")
    assert np.array_equal(labels_in(tmp_path / "window"), expected)
    run(*source, *QUICK, f"output={tmp_path / 'none'}")
    assert "history   off: without poses=..." in capsys.readouterr().out
    alone = labels_in(tmp_path / "none")
    assert np.array_equal(alone[0], expected[0])
    assert (alone == UNKNOWN).sum() >= (expected == UNKNOWN).sum()  # past frames saw more
    assert all((alone[k] != expected[k]).any() for k in range(1, len(FRAMES)))


def test_recorded_frames_give_labels_and_scores_of_evaluation(evaluated, scene, checkpoint, tmp_path, capsys, run):
    expected, figures = evaluated
    run(f"checkpoint={checkpoint}", f"recorded={scene.parent}", *QUICK, f"output={tmp_path}")
    assert np.array_equal(labels_in(tmp_path / scene.name), expected)
    metrics = json.loads((tmp_path / "metrics.json").read_text())["metrics"]
    assert {key: np.nan if value is None else value for key, value in metrics.items()} == pytest.approx(
        figures, nan_ok=True
    )
    assert f"5 frames: voxel RayIoU {figures['test/rayiou']:.3f}" in capsys.readouterr().out


def test_a_few_frames_have_the_history_of_all(evaluated, scene, checkpoint, tmp_path, capsys, run):
    arguments = (f"checkpoint={checkpoint}", f"recorded={scene}", "frames=[4,2]", *QUICK, f"output={tmp_path}")
    run(*arguments)
    folder = tmp_path / scene.name
    assert sorted(path.name for path in folder.iterdir()) == ["000002", "000004"]
    for k in (2, 4):
        assert np.array_equal(np.load(folder / FRAMES[k] / "voxels.npz")["labels"], evaluated[0][k])
    capsys.readouterr()
    run(*arguments)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].startswith("2 frames are finished")
    assert "" not in lines


def test_a_stopped_run_continues(evaluated, scene, checkpoint, tmp_path, capsys, run):
    arguments = (f"checkpoint={checkpoint}", f"recorded={scene}", *QUICK, f"output={tmp_path}")
    run(*arguments)
    files = {name: tmp_path / scene.name / name / "voxels.npz" for name in FRAMES}
    before = {name: path.stat().st_mtime_ns for name, path in files.items()}
    whole = (tmp_path / "metrics.json").read_text()
    files["000003"].unlink()
    capsys.readouterr()
    run(*arguments)
    assert "4 frames are finished" in capsys.readouterr().out
    assert [name for name in FRAMES if files[name].stat().st_mtime_ns != before[name]] == ["000003"]
    assert np.array_equal(labels_in(tmp_path / scene.name), evaluated[0])
    assert (tmp_path / "metrics.json").read_text() == whole
    run(*arguments, "force=true")
    assert all(files[name].stat().st_mtime_ns != before[name] for name in FRAMES)
    with pytest.raises(UserError, match=r"history.*stream.*force=true"):
        run(*arguments, "history=none")


def test_files_of_a_frame(images, scene, checkpoint, tmp_path, evaluated, monkeypatch, run):
    run(f"checkpoint={checkpoint}", f"recorded={scene}", "frames=[1]", f"output={tmp_path}")
    folder = tmp_path / scene.name / "000001"
    assert sorted(path.name for path in folder.iterdir()) == ["overview.png", "voxels.npz", "voxels.ply"]
    assert cv2.imread(str(folder / "overview.png")).shape[1] == 1280
    header = (folder / "voxels.ply").read_bytes().split(b"end_header")[0].decode()
    assert (
        int(re.search(r"element vertex (\d+)", header)[1]) == 2 * int(re.search(r"element face (\d+)", header)[1]) > 0
    )
    arrays = np.load(folder / "voxels.npz")
    assert np.array_equal(arrays["labels"], evaluated[0][1])
    assert arrays["labels"].dtype == np.uint8
    assert arrays["class_names"][7] == "Vehicle"
    assert arrays["class_colors"][7].tolist() == [142, 0, 0]
    assert np.array_equal(arrays["world_from_ego"], SceneReader(scene).world_from_ego[1])
    # the code of the docs that places voxels, verbatim
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "predict.md").read_text(), re.DOTALL)
    code = next(block for block in blocks if "xyz_m" in block)
    (tmp_path / "occupancy").mkdir()
    shutil.copy(folder / "voxels.npz", tmp_path / "occupancy")
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(code, found)
    geometry = load(checkpoint).occupancy.geometry
    occupied = evaluated[0][1] > 0
    assert np.allclose(found["xyz_m"], geometry.centers(torch.float64).numpy()[occupied])
    assert found["names"].tolist() == [arrays["class_names"][k] for k in evaluated[0][1][occupied]]


def test_cameras_of_another_rig_and_fewer_of_them(checkpoint, images, tmp_path, capsys, run):
    rig = Rig.load("surround_view").resized(96, 64)
    for frame in ("9", "10"):  # in this order
        (tmp_path / "sequence" / frame).mkdir(parents=True)
        for k, name in enumerate(rig.names[:3]):
            shutil.copy(images / FRAMES[0] / f"{RIG.names[k]}.png", tmp_path / "sequence" / frame / f"{name}.png")
            image = cv2.imread(str(tmp_path / "sequence" / frame / f"{name}.png"))
            cv2.imwrite(str(tmp_path / "sequence" / frame / f"{name}.png"), cv2.resize(image, (96, 64)))
    rig.save(tmp_path / "four.yaml")
    (tmp_path / "poses.csv").write_text("9,0,0,0,1,0,0,0\n10,1,0,0,1,0,0,0\n")
    source = (f"checkpoint={checkpoint}", f"images={tmp_path / 'sequence'}", f"rig={tmp_path / 'four.yaml'}")
    run(*source, f"poses={tmp_path / 'poses.csv'}", f"exclude_cameras=[{rig.names[3]}]", f"output={tmp_path / 'out'}")
    assert "not those of the training (fisheye6)" in capsys.readouterr().out
    first, second = (np.load(tmp_path / "out" / name / "voxels.npz")["labels"] for name in ("9", "10"))
    assert (first != second).any()  # 10 has a past, 9 has none
    shutil.copytree(tmp_path / "sequence" / "9", tmp_path / "alone" / "9")
    source = (f"checkpoint={checkpoint}", f"images={tmp_path / 'alone'}", f"rig={tmp_path / 'four.yaml'}")
    run(*source, f"exclude_cameras={rig.names[3]}", f"output={tmp_path / 'out2'}", *QUICK)  # one needs no brackets
    assert np.array_equal(np.load(tmp_path / "out2" / "9" / "voxels.npz")["labels"], first)


def test_a_rig_whose_origin_lies_elsewhere(evaluated, images, checkpoint, tmp_path, capsys, run):
    """Move the origin of the same car's files 1.7 m down, to half a metre above the road."""
    poses = RIG.ego_from_camera.clone()
    poses[:, 2, 3] += 1.7
    Rig(RIG.cameras, poses, RIG.names, RIG.masks).save(tmp_path / "low.yaml")
    lower = torch.eye(4, dtype=torch.float64)
    lower[2, 3] = -1.7
    world_from_low = read_poses(images / "poses.csv", FRAMES) @ lower
    write_poses(tmp_path / "low.csv", FRAMES, world_from_low)
    source = (f"checkpoint={checkpoint}", f"images={images}", f"rig={tmp_path / 'low.yaml'}")
    run(*source, f"poses={tmp_path / 'low.csv'}", "road_z_m=-0.5", "overview=false", f"output={tmp_path / 'out'}")
    assert "0.5 m below the origin of the rig (its road_z_m), 2.2 m in the training" in capsys.readouterr().out
    labels = labels_in(tmp_path / "out")
    assert (labels == evaluated[0])[labels != UNKNOWN].mean() > 0.999  # apart from rounding of poses
    arrays = np.load(tmp_path / "out" / FRAMES[1] / "voxels.npz")
    assert np.allclose((arrays["low"][2], arrays["high"][2]), (-2.8 + 1.7, 3.6 + 1.7))
    assert np.allclose(arrays["world_from_ego"], world_from_low[1].numpy())
    header, _, body = (tmp_path / "out" / FRAMES[1] / "voxels.ply").read_bytes().partition(b"end_header\n")
    count = int(re.search(rb"element vertex (\d+)", header)[1])
    z = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)], count)["xyz"][:, 2]
    assert -1.1001 <= z.min() < -1.0
    assert z.max() <= 5.3001


def test_an_excluded_camera_colours_nothing(checkpoint, images, tmp_path, run):
    """Its image makes no difference."""
    ring = torch.tensor([[5.0, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0]])
    sees = RIG.project(ring)[1]
    assert sees[RIG.names.index("rear")].any()
    sees[RIG.names.index("rear")] = False
    assert torch.equal(mask_cameras(RIG, ("rear",)).project(ring)[1], sees)
    other = tmp_path / "other"
    shutil.copytree(images, other)
    (other / FRAMES[0] / "rear.png").write_bytes((other / FRAMES[0] / "front.png").read_bytes())
    labels = []
    for k, folder in enumerate((images, other)):
        source = f"checkpoint={checkpoint}", f"images={folder / FRAMES[0]}", f"rig={folder / 'rig.yaml'}"
        run(*source, "exclude_cameras=[rear]", *QUICK, f"output={tmp_path / str(k)}")
        labels.append(np.load(tmp_path / str(k) / "voxels.npz")["labels"])
    assert np.array_equal(*labels)


def test_mistakes_are_named_in_a_line(images, scene, checkpoint, tmp_path, capsys, run):
    content = torch.load(checkpoint, weights_only=True)
    depth = {
        name.replace("sketch.depth.", ""): value for name, value in content["state_dict"].items() if ".depth." in name
    }
    torch.save({STAGE: "depth", CONFIG: content["config"], "state_dict": depth}, tmp_path / "depth.ckpt")
    (tmp_path / "damaged.ckpt").write_bytes(checkpoint.read_bytes()[:3000])
    next(value for name, value in content["state_dict"].items() if "classifier" in name).fill_(torch.nan)
    torch.save(content, tmp_path / "nan.ckpt")
    cropped = tmp_path / "cropped"
    shutil.copytree(images / FRAMES[0], cropped)
    cv2.imwrite(str(cropped / "rear.png"), np.zeros((48, 64, 3), np.uint8))
    poses = (images / "poses.csv").read_text().splitlines()
    (tmp_path / "few.csv").write_text("\n".join(poses[:-1]))
    (tmp_path / "nan.csv").write_text("\n".join([*poses[:-1], "000004" + ",nan" * 16]))
    (tmp_path / "file").write_text("in the way")
    trained, own, rig = f"checkpoint={checkpoint}", f"images={images}", f"rig={images / 'rig.yaml'}"
    cases = (
        ([f"checkpoint={tmp_path / 'depth.ckpt'}", own, rig], ["depth stage", "best.ckpt"]),
        ([f"checkpoint={tmp_path / 'damaged.ckpt'}", own, rig], ["damaged.ckpt"]),
        ([f"checkpoint={tmp_path / 'nan.ckpt'}", own, rig], ["nan.ckpt", "NaN"]),
        ([trained], ["either images=", "or recorded="]),
        ([trained, own], ["rig=...", f"there is {images / 'rig.yaml'}"]),
        ([trained, own, "rig=fisheye7"], ["fisheye7", "fisheye6"]),
        ([trained, own, rig, "history=strem"], ["history", "'strem'", "'stream'"]),
        ([trained, own, rig, "history=stream"], ["history=stream", "poses=..."]),
        ([trained, own, rig, f"poses={tmp_path / 'few.csv'}"], ["few.csv", "no pose of frame '000004'", "'000003'"]),
        ([trained, own, rig, f"poses={tmp_path / 'nan.csv'}"], ["line 6", "frame '000004'", "no finite number"]),
        ([trained, f"images={images / FRAMES[0]}", rig, f"poses={images / 'poses.csv'}"], ["single frame"]),
        ([trained, f"images={cropped}", rig], ["rear.png", "64x48", "64x36"]),
        ([trained, f"images={images / FRAMES[0]}", "rig=surround_view"], ["no image", "rear_left"]),
        ([trained, own, rig, f"output={tmp_path / 'file' / 'x'}"], ["cannot be written", "output="]),
        ([trained, own, rig, "device=tpu9"], ["device=tpu9"]),
        ([trained, own, rig, "scene=x"], ["scene=", "recorded="]),
        ([trained, f"recorded={scene}", rig], ["rig=", "images="]),
        ([trained, f"recorded={scene}", "frames=[5]"], ["frames=[5]", "0 to 4"]),
        ([trained, f"recorded={scene.parent}", "scene=test-000-nowere"], ["did you mean 'test-000-nowhere'"]),
        ([trained, f"recorded={tmp_path}"], ["no recorded scenes"]),
        (
            [trained, f"recorded={scene}", "exclude_cameras=[raer]"],
            ["=raer", "is it 'rear'", "front_left"],
        ),
        (
            [trained, f"recorded={scene}", f"exclude_cameras=[{','.join(Rig.load(images / 'rig.yaml').names)}]"],
            ["every camera"],
        ),
    )
    for k, (arguments, words) in enumerate(cases):
        with pytest.raises(UserError) as caught:
            run(f"output={tmp_path / f'out{k}'}", *arguments)
        for word in words:
            assert word in str(caught.value), arguments
        assert len(str(caught.value).splitlines()) <= 2, arguments
    for path, arguments in (("nowhere.ckpt", [own, rig]), ("no.csv", [own, rig, trained, "poses=no.csv"])):
        with pytest.raises(OSError, match=path):
            run(
                f"output={tmp_path / 'out'}",
                *(arguments if trained in arguments else [f"checkpoint={path}", *arguments]),
            )


def test_the_depth_network_of_an_occupancy_checkpoint(checkpoint, tmp_path):
    depth = load(checkpoint).depth
    inside = load(checkpoint).task.model.sketch.depth.state_dict()
    assert len(inside) > 20
    assert depth.state_dict().keys() == inside.keys()
    assert all(torch.equal(value, inside[name]) for name, value in depth.state_dict().items())
    content = torch.load(checkpoint, weights_only=True)
    rest = {name: value for name, value in content["state_dict"].items() if ".sketch." not in name}
    torch.save({STAGE: "occupancy", CONFIG: content["config"], "state_dict": rest}, tmp_path / "dense.ckpt")
    with pytest.raises(UserError, match=r"dense\.ckpt.*depth"):
        load(tmp_path / "dense.ckpt").depth  # noqa: B018 - it is built when it is asked for


def test_a_folder_without_a_scene_cannot_be_exported(tmp_path):
    with pytest.raises(UserError, match="recorded scene"):
        export_scene(tmp_path, tmp_path / "out")


def test_a_model_of_nineteen_classes_scores_its_own(scene, checkpoint, images, smoke, spec, tmp_path, capsys, run):
    classes = ClassTable(tuple(SemanticClass(k, f"kind{k}", (k, 2 * k, 255 - k)) for k in range(19)))
    spec = dataclasses.replace(spec, classes=classes, range_edges_m=(0.0, 10.0, 20.0), road_z_m=-1.7)
    root = tmp_path / "scenes"
    for name in ("train-000-here", "test-000-here"):
        write_scene(root / name, spec, 0, 2, RIG)
    splits = "data.source.splits={train: [train-*], val: [], test: [test-*]}"
    cfg = smoke("data=recorded", f"data.source.root={root}", splits, "data.num_classes=19")
    trained = write_checkpoint(tmp_path / "nineteen.ckpt", cfg, spec)

    run(f"checkpoint={trained}", f"recorded={root}", "overview=false", f"output={tmp_path / 'out'}")
    assert "as in training" in capsys.readouterr().out
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())["metrics"]
    names = {key.rpartition("/")[2] for key in metrics if key.startswith("test/voxel/iou/")}
    assert names == set(classes.names[1:])
    assert {"test/rayiou_0-10m", "test/lidar/rayiou/kind18"} <= set(metrics)
    arrays = np.load(tmp_path / "out" / "test-000-here" / FRAMES[1] / "voxels.npz")
    assert arrays["class_names"].tolist() == list(classes.names)

    source = source_of(images, trained)
    run(*source, *QUICK, "road_z_m=-0.7", f"output={tmp_path / 'own'}")  # 1 m higher than in training
    low = load(trained).occupancy.geometry.height_m[0]
    assert np.load(tmp_path / "own" / FRAMES[0] / "voxels.npz")["low"][2] == pytest.approx(low + 1)

    with pytest.raises(UserError, match=r"has 12 classes .*trained with 19"):
        run(f"checkpoint={trained}", f"recorded={scene}", f"output={tmp_path / 'other'}")


def test_a_network_without_classes_is_scored_without_them(scene, smoke, spec, tmp_path, capsys, run):
    alone = dataclasses.replace(spec, classes=OCCUPANCY_CLASSES)
    write_scene(tmp_path / "scenes" / "train-000-here", alone, 0, 2, RIG)
    splits = "data.source.splits={train: [train-*], val: [], test: []}"
    cfg = smoke("data=recorded", f"data.source.root={tmp_path / 'scenes'}", splits, "data.num_classes=2")
    trained = write_checkpoint(tmp_path / "two.ckpt", cfg, alone)
    run(f"checkpoint={trained}", f"recorded={scene}", "overview=false", f"output={tmp_path / 'out'}")
    assert "classes   free and occupied alone: scores are without classes" in capsys.readouterr().out
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())["metrics"]
    assert {key for key in metrics if key.startswith("test/voxel/iou/")} == {"test/voxel/iou/occupied"}
    assert metrics["test/voxel/iou/occupied"] == metrics["test/voxel/iou"] > 0
    assert metrics["test/rayiou"] == metrics["test/occupied/rayiou"]


def test_a_network_of_drawn_rigs_keeps_its_grid_around_the_origin_of_the_rig(
    images, smoke, spec, tmp_path, capsys, run
):
    """As in its training, where every rig had the road at another height and labels lay around the rig."""
    cfg = smoke("data.source.rig=random")
    trained = write_checkpoint(tmp_path / "drawn.ckpt", cfg, dataclasses.replace(spec, road_z_m=None))
    shutil.copytree(images / FRAMES[0], tmp_path / "alone" / FRAMES[0])
    source = f"checkpoint={trained}", f"images={tmp_path / 'alone'}", f"rig={images / 'rig.yaml'}"
    run(*source, *QUICK, "road_z_m=-0.7", f"output={tmp_path / 'out'}")
    assert "the grid stays around the origin of the rig" in capsys.readouterr().out
    low = np.load(tmp_path / "out" / FRAMES[0] / "voxels.npz")["low"][2]
    assert low == pytest.approx(load(trained).occupancy.geometry.height_m[0])


def test_exported_images_state_the_road_and_are_those_of_the_training(images, checkpoint, spec, tmp_path, capsys, run):
    assert Rig.load(images / "rig.yaml").road_z_m == spec.road_z_m
    shutil.copytree(images / FRAMES[0], tmp_path / "alone" / FRAMES[0])
    source = f"checkpoint={checkpoint}", f"images={tmp_path / 'alone'}", f"rig={images / 'rig.yaml'}"
    run(*source, *QUICK, f"output={tmp_path / 'out'}")
    assert "road  " not in capsys.readouterr().out


def test_a_road_at_another_height_than_in_training_is_told(scene, spec):
    sequences = find_scenes(scene, None, None)
    same, low, drawn = (SimpleNamespace(road_z_m=height_m) for height_m in (spec.road_z_m, -0.9, None))
    assert other_heights(sequences, same) == []
    assert other_heights(sequences, drawn) == []
    (line,) = other_heights(sequences, low)
    assert "2.2 m below the origin of test-000-nowhere, 0.9 m in the training" in line


@pytest.mark.parametrize(("frames", "words"), [(2, "up to 1 past frame"), (3, "up to 2 past frames")])
def test_past_frames_are_counted_in_the_right_number(frames, words):
    model = SimpleNamespace(
        geometry=SimpleNamespace(shape=()), temporal=SimpleNamespace(frames=frames), parameters=list
    )
    trained, sequence = SimpleNamespace(compare=str), SimpleNamespace(rig=SimpleNamespace(names=()))
    lines = announcement(SimpleNamespace(checkpoint="best.ckpt"), model, trained, [sequence], "stream", "")
    assert lines[-1] == f"history   stream: {words}"
