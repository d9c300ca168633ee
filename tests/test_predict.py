"""`src/predict.py` as users start it."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scripts import run_script

from omniocc.camera import Rig
from omniocc.commands import predict as script
from omniocc.config import build, plain
from omniocc.errors import UserError
from omniocc.predict.depth import predict_panoramas
from omniocc.runs.checkpoint import CONFIG, STAGE

SMALL = ("checkpoint=sweep", "preset=smoke", "image_width=64", "rig=fisheye6")


def draw_frame(folder: Path, seed: int) -> Path:
    """Draw images of a noise texture at infinity, which every camera sees alike."""
    folder.mkdir(parents=True)
    sky = np.random.default_rng(seed).integers(0, 255, (24, 48, 3), dtype=np.uint8)
    rig = Rig.load("fisheye6").resized(128, 72)
    for k, name in enumerate(rig.names):
        rays = rig.rays(k)[0].numpy()
        column = ((np.pi - np.arctan2(rays[..., 1], rays[..., 0])) / (2 * np.pi) * 48).astype(int) % 48
        row = ((1 - rays[..., 2]) / 2 * 24).astype(int).clip(0, 23)
        cv2.imwrite(str(folder / f"{name}.png"), sky[row, column])
    return folder


@pytest.fixture(scope="module")
def frames(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("frames")
    for name, seed in (("0000", 0), ("0001", 1)):
        draw_frame(folder / name, seed)
    return folder


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, smoke) -> Path:
    """Return a checkpoint of the depth stage with initial weights."""
    cfg = smoke("model/depth=mono")
    weights = {f"model.{name}": value for name, value in build(cfg.depth).state_dict().items()}
    path = tmp_path_factory.mktemp("stage") / "last.ckpt"
    torch.save({STAGE: "depth", CONFIG: plain(cfg), "state_dict": weights}, path)
    return path


@pytest.mark.slow
def test_frames_without_weights(frames, tmp_path):
    result = run_script("predict.py", "depth", *SMALL, f"images={frames}", "output=out", cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    assert len(result.stdout.splitlines()) == 2
    assert "depth " in result.stdout
    names = ["overview.png", "points.ply", "range.npz", "range.png"]
    for frame in ("0000", "0001"):
        assert sorted(path.name for path in (tmp_path / "out" / frame).iterdir()) == names
        range_m = np.load(tmp_path / "out" / frame / "range.npz")["range_m"]
        code = cv2.imread(str(tmp_path / "out" / frame / "range.png"), cv2.IMREAD_UNCHANGED)
        assert range_m.shape == code.shape == (12, 48)
        assert ((code > 0) == np.isfinite(range_m)).all()


@pytest.fixture
def run_here(composed) -> Callable[..., None]:
    """Run the command in this process: another one takes seconds to start."""

    def run(*overrides: str) -> None:
        predict_panoramas(composed(*overrides, name="predict_depth"), list(overrides))

    return run


def test_a_checkpoint_and_a_list_of_images(frames, checkpoint, tmp_path, capsys, run_here):
    names = Rig.load("fisheye6").names
    listed = ",".join(str(frames / "0000" / f"{name}.png") for name in names)
    run_here(
        "rig=fisheye6", f"images=[{listed}]", f"checkpoint={checkpoint}", f"output={tmp_path}", "exclude_cameras=rear"
    )
    assert "48x12 px" in capsys.readouterr().out
    assert np.load(tmp_path / "range.npz")["range_m"].shape == (12, 48)
    assert (tmp_path / "points.ply").stat().st_size > 300


def test_a_checkpoint_takes_other_edges_but_not_other_sizes_of_its_network(frames, checkpoint, tmp_path, run_here):
    arguments = ("rig=fisheye6", f"images={frames / '0000'}", f"checkpoint={checkpoint}", f"output={tmp_path}")
    run_here(*arguments, "depth.panorama.bottom_deg=-60")
    assert float(np.load(tmp_path / "range.npz")["bottom_deg"]) == -60
    with pytest.raises(UserError, match="weights"):
        run_here(*arguments, "+depth.channels=[8,8,8,8]")


def test_the_default_are_the_weights_for_any_rig_and_an_unknown_road_is_told(frames, tmp_path, capsys, run_here):
    arguments = f"images={frames / '0000'}", f"output={tmp_path}"
    run_here("rig=fisheye6", *arguments)
    assert "road      its height is not known" in capsys.readouterr().out
    learned = np.load(tmp_path / "range.npz")["range_m"]
    run_here("rig=fisheye6", "checkpoint=any-rig", *arguments)
    assert np.array_equal(learned, np.load(tmp_path / "range.npz")["range_m"], equal_nan=True)
    replace(Rig.load("fisheye6"), road_z_m=-2.2).save(tmp_path / "rig.yaml")
    capsys.readouterr()
    run_here(f"rig={tmp_path / 'rig.yaml'}", *arguments)
    assert "not known" not in capsys.readouterr().out
    run_here(*SMALL, *arguments)
    swept = np.load(tmp_path / "range.npz")["range_m"]
    run_here(*SMALL[1:], "checkpoint=null", *arguments)
    assert np.array_equal(swept, np.load(tmp_path / "range.npz")["range_m"], equal_nan=True)
    assert swept.shape != learned.shape
    assert "not known" not in capsys.readouterr().out  # the sweep does not use it


def test_results_of_other_frames_are_told(frames, tmp_path, capsys, run_here):
    arguments = (*SMALL, f"output={tmp_path}")
    run_here(*arguments, f"images={frames}")
    run_here(*arguments, f"images={frames}")
    assert "output  " not in capsys.readouterr().out
    run_here(*arguments, f"images={frames / '0000'}")
    line = (
        f"output    ranges of 2 other frames stay beside the new ones: {tmp_path / '0000'}, {tmp_path / '0001'}; remove"
    )
    assert line in capsys.readouterr().out
    run_here(*arguments, f"images={frames}")
    assert f"output    ranges of 1 other frame stay beside the new ones: {tmp_path}; " in capsys.readouterr().out


def test_images_in_the_wrong_order_are_told(frames, tmp_path, capsys, run_here):
    names = ["front", "front_right", "rear_right", "rear", "rear_left", "front_left"]
    assert list(Rig.load("fisheye6").names) == names
    names[0], names[1] = names[1], names[0]
    for k, name in enumerate(names):
        shutil.copy(frames / "0000" / f"{name}.png", tmp_path / f"{k}.png")
    listed = ",".join(f"{tmp_path / str(k)}.png" for k in range(6))
    run_here(*SMALL, f"images=[{listed}]", f"output={tmp_path / 'out'}")
    told = [line for line in capsys.readouterr().out.splitlines() if "swapped" in line]
    assert len(told) == 1
    assert f"front={tmp_path}/1.png, front_right={tmp_path}/0.png; " in told[0]
    run_here(*SMALL, f"images={frames}", f"output={tmp_path / 'out'}")
    assert "swapped" not in capsys.readouterr().out


def test_mistakes_are_named(frames, checkpoint, tmp_path, run_here):
    lacking = tmp_path / "lacking"
    shutil.copytree(frames / "0000", lacking)
    (lacking / "rear.png").unlink()
    damaged = tmp_path / "damaged.ckpt"
    damaged.write_bytes(checkpoint.read_bytes()[:500])
    content = torch.load(checkpoint, weights_only=True)
    next(iter(content["state_dict"].values())).fill_(torch.nan)
    torch.save(content, tmp_path / "nan.ckpt")
    frame, output = f"images={frames / '0000'}", f"output={tmp_path / 'out'}"
    for arguments, words in (
        ([frame], ["rig=..."]),
        (["rig=fisheye7", frame], ["fisheye7", "fisheye6"]),
        ([*SMALL, f"images={lacking}"], ["'rear'", "exclude_cameras=[rear]"]),
        ([*SMALL, frame, "model/depth=truth"], ["recorded range"]),
        ([*SMALL, frame, "bev_range_m=0"], ["bev_range_m: 0 is not a number above 0"]),
        ([*SMALL, frame, "image_width=wide"], ["image_width: 'wide' is not a whole number or null"]),
        ([*SMALL, frame, "+depth.windov_px=3"], ["did you mean 'window_px'"]),
        (["rig=fisheye6", frame, "preset=tiny"], ["preset=tiny", "checkpoint=any-rig", "checkpoint=sweep"]),
        (["rig=fisheye6", frame, f"checkpoint={damaged}"], ["damaged.ckpt"]),
        (["rig=fisheye6", frame, f"checkpoint={tmp_path / 'nan.ckpt'}"], ["nan.ckpt", "NaN"]),
        (["rig=fisheye6", frame, f"checkpoint={checkpoint}", "preset=tiny"], ["preset=tiny", "checkpoint"]),
    ):
        with pytest.raises(UserError) as caught:
            run_here(*arguments, output)
        for word in words:
            assert word in str(caught.value)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.ckpt"):
        run_here("rig=fisheye6", frame, "checkpoint=nowhere.ckpt", output)
    assert not (tmp_path / "out").exists()


def test_the_command_line_prints_one_line(tmp_path):
    result = run_script("predict.py", "depth", "rig=fisheye6", f"images={tmp_path / 'nothing'}", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stdout == ""
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stderr.startswith(f"images={tmp_path / 'nothing'}")


def test_help_and_unknown_commands(capsys, monkeypatch):
    for arguments, code in ((["--help"], 0), ([], 2), (["occupanzy"], 2)):
        monkeypatch.setattr(sys, "argv", ["predict.py", *arguments])
        with pytest.raises(SystemExit) as caught:
            script.main()
        assert caught.value.code == code
        told = capsys.readouterr()
        assert told.out.startswith("usage: python src/predict.py <command> ")
        assert "  occupancy   Predict the voxels of every frame\n" in told.out
        unknown = "there is no command 'occupanzy'; did you mean occupancy?\n"
        assert told.err == (unknown if "occupanzy" in arguments else "")


def test_help_of_occupancy_shows_files_examples_and_options(tmp_path):
    assert "for checkpoint=sweep alone" in run_script("predict.py", "depth", "--help", cwd=tmp_path).stdout
    result = run_script("predict.py", "occupancy", "--help", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    for words in ("voxels.npz", "poses=my_poses.csv", "\nhistory=null "):
        assert words in result.stdout
    assert not list(tmp_path.iterdir())
