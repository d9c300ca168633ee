"""Offline W&B runs, read back from the disk with W&B's own messages."""

import json
import math
import os
import shutil
import signal
import time
from collections import Counter
from math import nan
from pathlib import Path

import numpy as np
import pytest
import torch
import wandb
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from offline_file import STEP, files_of, history, records, runs_in, summary
from torch.utils.data import DataLoader

from omniocc.errors import UserError
from omniocc.runs.wandb import Loggers
from omniocc.runs.wandb.loggers import (
    WandbCurves,
    finish,
    log_earlier_stages,
    log_file,
    result_tables,
    row_of,
    rows_in_csv,
    wandb_of,
)
from omniocc.runs.wandb.media import MediaItem

CONFIG = {
    "name": "mono",
    "seed": 3,
    "stage": None,
    "model": {
        "geometry": {"_target_": "omniocc.geometry.Cuboid", "shape": [4, 4, 2]},
        "sketch": {"_target_": "omniocc.model.sketch.Dense"},
    },
    "depth": {"_target_": "omniocc.model.depth.OmniMVS"},
}
STEPS, PER_EPOCH, FAILS_AT, CHECKPOINT_EVERY = 9, 3, 5, 2


class Line(LightningModule):
    """Trains a few steps without learning anything; may fail at one of them."""

    def __init__(self, fails_at=None):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))
        self.fails_at = fails_at

    def training_step(self, batch, batch_index):
        if self.global_step == self.fails_at:
            raise ConnectionAbortedError
        self.log("train/loss", float(self.global_step))
        return (self.weight * batch).mean()

    def validation_step(self, batch, batch_index):
        self.log("val/rayiou", float(self.global_step))

    def test_step(self, batch, batch_index):
        self.log_dict({"test/rayiou/Road": 0.5, "test/rayiou_0-8.5m": 0.25, "test/rayiou/Pole": math.nan})
        self.log_dict({"prior/rayiou": 0.125, "label/rayiou": 1.0})

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


def trainer_of(folder, *callbacks):
    return Trainer(
        max_steps=STEPS,
        accelerator="cpu",
        logger=Loggers("offline", "p", "tiny", ["x"]).build(folder, CONFIG, "occupancy"),
        callbacks=[
            ModelCheckpoint(folder, "last", every_n_train_steps=CHECKPOINT_EVERY, enable_version_counter=False),
            *callbacks,
        ],
        log_every_n_steps=1,
        num_sanity_val_steps=0,
        enable_progress_bar=False,
        enable_model_summary=False,
    )


@pytest.fixture(scope="module")
def resumed(tmp_path_factory):
    """Return the folder of a run that failed between two checkpoints and was started again."""
    folder = tmp_path_factory.mktemp("runs") / "mono-0123abcd"
    folder.mkdir()
    many, one = DataLoader(torch.ones(PER_EPOCH)), DataLoader(torch.ones(1))
    first = trainer_of(folder)
    with pytest.raises(ConnectionAbortedError):
        first.fit(Line(FAILS_AT), many, one)
    finish(first.loggers)
    wandb.teardown()
    time.sleep(1.1)  # W&B names its folders by the second
    second = trainer_of(folder)
    second.fit(Line(), many, one, ckpt_path=folder / "last.ckpt")
    second.test(second.lightning_module, one, verbose=False)
    for curves in wandb_of(second.loggers):
        cloud = np.array([[1.0, 2.0, 0.5, 128, 64, 128]])
        media = {
            "test/bev": [MediaItem(np.zeros((4, 4, 3), np.uint8), "scene/0 truth")],
            "test/points": [MediaItem(cloud, "a")],
        }
        curves.log_media(media, second.global_step)
    finish(second.loggers)
    wandb.teardown()
    return folder


def test_a_run_has_its_group_tags_job_type_and_slots(resumed):
    first, second = (run for path in files_of(resumed) for run in runs_in(path))
    assert first.run_id == second.run_id
    for run in (first, second):
        assert (run.project, run.run_group, run.job_type) == ("p", "tiny", "occupancy")
        assert (run.display_name, list(run.tags)) == ("mono-0123abcd", ["mono", "x"])
    config = {item.key: json.loads(item.value_json) for item in first.config.update}
    assert (config["row"], config["slots"], config["seed"]) == ("mono", {"geometry": "cuboid", "sketch": "dense"}, 3)
    assert config["model"]["geometry"]["shape"] == [4, 4, 2]


def test_a_resumed_run_continues_its_curves(resumed):
    rows = [row for path in files_of(resumed) for row in history(path)]
    assert len(files_of(resumed)) == 2
    loss = [(row[STEP], row["train/loss"]) for row in rows if "train/loss" in row]
    assert loss == [(step, float(step)) for step in range(STEPS)]
    assert [(row[STEP], row["val/rayiou"]) for row in rows if "val/rayiou" in row] == [(2, 3.0), (5, 6.0), (8, 9.0)]
    assert max(Counter(key for row in rows for key in row if key.startswith("test/")).values()) == 1


def test_scores_of_a_test_are_a_summary_and_no_charts(resumed):
    charts = {key for path in files_of(resumed) for row in history(path) for key in row}
    charts = {key for key in charts if not key.startswith("_")}
    assert charts == {
        "train/loss",
        "val/rayiou",
        "test/bev",
        "test/points",
        "tables/by_class",
        "tables/by_range",
        "epoch",
        STEP,
    }
    found = summary(files_of(resumed)[1])
    scores = {"test/rayiou/Road": 0.5, "test/rayiou_0-8.5m": 0.25, "prior/rayiou": 0.125, "label/rayiou": 1.0}
    assert {key: found[key] for key in scores} == scores
    assert found["test/rayiou/Pole"] is None, "W&B has no nan"


def test_figures_of_earlier_stages_are_a_summary(tmp_path):
    loggers = Loggers("offline", "p", None, []).build(tmp_path, CONFIG, "occupancy")
    log_earlier_stages(loggers, {"val/depth/mae": 1.5, "test/depth/mae_0-8.5m": 0.5}, 7)
    finish(loggers)
    wandb.teardown()
    assert rows_in_csv(tmp_path) == {(7, "val/depth/mae"), (7, "test/depth/mae_0-8.5m")}
    (path,) = files_of(tmp_path)
    assert summary(path)["val/depth/mae"] == 1.5
    assert summary(path)["test/depth/mae_0-8.5m"] == 0.5
    assert {key for row in history(path) for key in row if "depth" in key} == set()
    (table,) = (row["tables/by_range"] for row in history(path) if "tables/by_range" in row)
    assert table["nrows"] == 1


def test_images_points_and_tables_are_saved_as_files(resumed):
    (last,) = [row for row in history(files_of(resumed)[1]) if "test/bev" in row]
    folder = files_of(resumed)[1].parent / "files"
    image, cloud = last["test/bev"], last["test/points"]
    assert image["captions"] == ["scene/0 truth"]
    assert (folder / image["filenames"][0]).stat().st_size > 100
    points = json.loads((folder / "media" / "object3D" / cloud["filenames"][0]).read_text())
    assert points["points"] == [[1.0, 2.0, 0.5, 128, 64, 128]]
    assert points["boxes"][0]["label"] == "own car"
    (tables,) = [row for row in history(files_of(resumed)[1]) if "tables/by_class" in row]
    table = json.loads((folder / tables["tables/by_class"]["path"]).read_text())
    assert table["columns"] == ["class", "voxel RayIoU"]
    assert table["data"][0] == ["Road", 0.5]
    assert tables["tables/by_range"]["nrows"] == 1


def test_the_csv_file_has_every_row_at_once(tmp_path):
    csv_logger, *_ = Loggers("disabled", "p", None, []).build(tmp_path, CONFIG, "occupancy")
    csv_logger.log_metrics({"train/loss": 2.5}, 3)
    csv_logger.log_metrics({"val/rayiou/Pole": math.nan, "epoch": 1}, 4)
    assert rows_in_csv(tmp_path) == {(3, "train/loss"), (4, "val/rayiou/Pole"), (4, "epoch")}


def test_the_half_written_line_of_a_kill_is_not_taken_for_logged(tmp_path):
    csv_logger, *_ = Loggers("disabled", "p", None, []).build(tmp_path, CONFIG, "occupancy")
    csv_logger.log_metrics({"train/loss": 2.5}, 3)
    csv_logger.log_metrics({"train/loss": 12.5}, 14)
    (path,) = tmp_path.glob("csv/version_0/metrics.csv")
    for _ in range(1, len("14,12.5\r\n")):
        path.write_bytes(path.read_bytes()[:-1])
        assert rows_in_csv(tmp_path) == {(3, "train/loss")}


def test_a_killed_run_repeats_neither_its_scalars_nor_their_images(tmp_path):
    """The CSV file ends with the validation of step 3, the checkpoint is older."""
    recipe, image = Loggers("offline", "p", None, []), MediaItem(np.zeros((4, 4, 3), np.uint8), "x")
    killed, *_ = recipe.build(tmp_path, CONFIG, "occupancy")
    killed.log_metrics({"train/loss": 2.0, "epoch": 0}, 2)
    killed.log_metrics({"val/rayiou": 0.1}, 3)
    (curves,) = wandb_of(recipe.build(tmp_path, CONFIG, "occupancy"))
    for step in (2, 3, 4):
        curves.log_metrics({"train/loss": float(step), "epoch": 0}, step)
        curves.log_media({"val/bev": [image]}, step)
    finish([curves])
    wandb.teardown()
    (path,) = files_of(tmp_path)
    rows = list(history(path))
    assert [row[STEP] for row in rows if "train/loss" in row] == [3, 4]
    assert [row[STEP] for row in rows if "val/bev" in row] == [2, 4]


def test_the_load_of_the_machine_is_logged(resumed):
    kinds = Counter(r.WhichOneof("record_type") for path in files_of(resumed) for r in records(path))
    assert kinds["stats"] > 0
    assert kinds["environment"] > 0


def test_a_stage_has_its_own_job_type_and_its_options_as_row(tmp_path):
    config = CONFIG | {"model": {"sketch": {"_target_": "omniocc.model.sketch.Dense"}}}
    (curves,) = wandb_of(Loggers("offline", "p", None, []).build(tmp_path / "depth-0", config, "depth"))
    settings = curves._wandb_init
    assert (settings["job_type"], settings["tags"], settings["id"] != "") == ("depth", [], True)
    assert settings["config"]["row"] == "depth omnimvs"
    assert row_of(config, "sketch") == "sketch dense on omnimvs"
    assert "anonymous" not in settings  # W&B would warn of it in every run


def test_only_the_last_stage_of_a_sweep_agents_run_is_logged(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_SWEEP_ID", "s1")
    recipe = Loggers("offline", "p", None, [])
    assert not wandb_of(recipe.build(tmp_path, CONFIG, "depth"))
    assert wandb_of(recipe.build(tmp_path, CONFIG, "occupancy"))
    assert wandb_of(recipe.build(tmp_path, CONFIG | {"stage": "depth"}, "depth"))


def test_disabled_leaves_the_csv_file_and_online_needs_a_login(tmp_path, monkeypatch):
    assert len(Loggers("disabled", "p", None, []).build(tmp_path, CONFIG, "occupancy")) == 1
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    with pytest.raises(UserError, match="wandb login"):
        Loggers("online", "p", None, []).build(tmp_path, CONFIG, "occupancy")


def test_tables_have_the_columns_that_were_measured():
    metrics = {"test/rayiou/Road": 0.5, "test/rayiou/Pole": nan, "test/rayiou": 0.3, "test/rayiou_8.5-17m": 0.2}
    tables = result_tables(metrics | {"test/depth/mae_0-8.5m": 1.5, "val/rayiou/Road": 1.0})
    by_class = tables["tables/by_class"]
    assert by_class.columns == ["class", "voxel RayIoU"]
    assert by_class.rows[0] == ["Road", 0.5]
    assert dict(map(tuple, by_class.rows))["Pole"] is None
    assert len(by_class.rows) == 2
    by_range = tables["tables/by_range"]
    assert by_range.columns == ["range", "voxel RayIoU", "depth: MAE, m"]
    assert by_range.rows == [["0-8.5m", None, 1.5], ["8.5-17m", 0.2, None]]


def test_a_run_that_was_not_tested_has_no_tables():
    assert result_tables({"train/loss": 1.0}) == {}


def test_a_robustness_test_has_a_line_for_every_disturbance():
    metrics = {"robustness/undisturbed/rayiou": 0.5, "robustness/view_90_deg/rayiou": 0.2}
    metrics |= {"robustness/view_90_deg/drop": 0.3, "robustness/view_90_deg/error": nan}
    table = result_tables(metrics)["tables/robustness"]
    assert table.columns == ["disturbance", "RayIoU", "drop", "standard error"]
    assert table.rows == [["undisturbed", 0.5, None, None], ["view_90_deg", 0.2, 0.3, None]]


def test_a_file_is_kept_as_an_artifact(tmp_path):
    folder, file = tmp_path / "ours 1", tmp_path / "view.rrd"
    folder.mkdir()
    file.write_bytes(b"content")
    log_file(folder, file, "streets")
    (found,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    artifacts = [record.artifact for record in records(found) if record.HasField("artifact")]
    assert [(one.name, one.type) for one in artifacts] == [("ours-1-view.rrd", "view")]
    assert [entry.path for entry in artifacts[0].manifest.contents] == ["view.rrd"]


class AtStep(Callback):
    """Does something to W&B in the middle of a training."""

    def __init__(self, harm):
        self.harm = harm

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == FAILS_AT:
            self.harm(trainer)


def kill_core(trainer):
    """Kill W&B's process, as the system does where memory ends."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words, parent = (
                (folder / "cmdline").read_bytes(),
                (folder / "stat").read_text().rpartition(")")[2].split()[1],
            )
        except OSError:  # it has just ended
            continue
        if b"wandb-core" in words and int(parent) == os.getpid():
            found.append(int(folder.name))
    assert found
    for process in found:
        os.kill(process, signal.SIGKILL)
    time.sleep(0.5)


def spoil_folder(trainer):
    """Let W&B's folder take no more images, as a full disk does."""
    (curves,) = wandb_of(trainer.loggers)
    media = Path(curves.experiment.dir, "media")
    shutil.rmtree(media)
    media.write_text("", encoding="utf-8")


class Drawn(Callback):
    def on_validation_end(self, trainer, *_):
        for curves in wandb_of(trainer.loggers):
            curves.log_media({"val/image": [MediaItem(np.zeros((4, 4, 3), np.uint8), "x")]}, trainer.global_step)


@pytest.fixture
def not_lost(monkeypatch):
    monkeypatch.setattr(WandbCurves, "lost", False)
    yield
    wandb.run = None  # W&B keeps one whose process is gone, which later tests would use


@pytest.mark.usefixtures("not_lost")
@pytest.mark.parametrize("harm", [None, kill_core, spoil_folder])
def test_a_training_outlives_wandb_and_says_so_once(tmp_path, monkeypatch, capsys, harm):
    if harm is None:
        monkeypatch.setenv("WANDB_DATA_DIR", "/dev/null/data")  # as if HOME could not be written
    folder = tmp_path / "mono-0"
    folder.mkdir()
    trainer = trainer_of(folder, Drawn(), *([] if harm is None else [AtStep(harm)]))
    many, one = DataLoader(torch.ones(PER_EPOCH)), DataLoader(torch.ones(1))
    trainer.fit(Line(), many, one)
    trainer.test(trainer.lightning_module, one, verbose=False)
    finish(trainer.loggers)
    printed = capsys.readouterr()
    (line,) = [line for line in printed.out.splitlines() if "W&B is left out" in line]
    assert "WANDB_DATA_DIR can be written, or give logger.mode=disabled" in line
    assert "Traceback" not in printed.out + printed.err
    assert {step for step, key in rows_in_csv(folder) if key == "train/loss"} == set(range(STEPS))
    assert (STEPS, "test/rayiou/Road") in rows_in_csv(folder)
    assert not wandb_of(trainer.loggers)
    assert not wandb_of(Loggers("offline", "p", None, []).build(folder, CONFIG, "occupancy"))


@pytest.mark.usefixtures("not_lost")
def test_a_mistake_of_ours_in_what_is_logged_is_raised(tmp_path):
    (curves,) = wandb_of(Loggers("offline", "p", None, []).build(tmp_path, CONFIG, "occupancy"))
    with pytest.raises(ValueError, match="shape"):
        curves.log_media({"val/image": [MediaItem(np.zeros((4, 4, 7), np.uint8), "x")]}, 1)
    assert wandb_of([curves]) == [curves]
    curves.finish()
