"""What is read from the folders of runs: made by hand, with times set, and by a run's own lock and logger."""

import itertools
import json
import os
import time

import pytest
from filelock import FileLock
from lightning.pytorch.loggers import CSVLogger
from made_runs import make_run

from omniocc.extras.viewer.watch.files import held_locks, identity
from omniocc.extras.viewer.watch.state import details, jobs, last_images, run_folders, run_states, thinned
from omniocc.progress import Status
from omniocc.runs.wandb.loggers import CSV


def states(runs):
    return {state.id: state for state in run_states(runs)}


def test_runs_and_stages_are_found_and_other_folders_are_not(tmp_path):
    make_run(tmp_path / "ours-1")
    make_run(tmp_path / "stages" / "depth-2")
    make_run(tmp_path / "stages" / "sketch-3")
    make_run(tmp_path / ".hidden")
    make_run(tmp_path / "of-another-encoding-\udcff")
    (tmp_path / "report").mkdir()
    (tmp_path / "note.txt").touch()
    assert list(run_folders(tmp_path)) == ["ours-1", "stages/depth-2", "stages/sketch-3"]
    assert run_folders(tmp_path / "nothing") == {}
    found = states(tmp_path)
    assert [found[name].stage for name in ("ours-1", "stages/depth-2", "stages/sketch-3")] == [
        "occupancy", "depth", "sketch",
    ]  # fmt: skip
    assert [found[name].steps for name in ("ours-1", "stages/depth-2", "stages/sketch-3")] == [1000, 500, None]
    assert found["ours-1"].step == 200
    assert found["ours-1"].score == ("val/rayiou", 0.375)


def test_the_time_left_follows_from_the_rate_since_the_last_start(tmp_path):
    make_run(tmp_path / "a", age_s=10.0)  # 100 steps in 100 s: 800 steps are left, 10 s of them are over
    make_run(tmp_path / "b", "step,train/loss\n99,2.5\n")
    assert states(tmp_path)["a"].left in ("13:09 min", "13:10 min")
    assert states(tmp_path)["b"].left == ""
    resumed = make_run(tmp_path / "c")
    version = resumed / "csv" / "version_1"
    version.mkdir()
    (version / "metrics.csv").write_text("step,train/loss\n249,2\n499,1\n")  # twice as fast
    now_s = time.time()
    os.utime(version / "metrics.csv", (now_s, now_s))
    os.utime(version, (now_s - 125, now_s - 125))
    assert states(tmp_path)["c"].left in ("4:09 min", "4:10 min")
    assert states(tmp_path)["c"].step == 500


def test_a_run_is_in_progress_while_its_lock_is_held_finished_with_figures_and_else_stopped(tmp_path):
    run = make_run(tmp_path / "a", age_s=600)
    assert states(tmp_path)["a"].state == "stopped"
    assert states(tmp_path)["a"].left == ""
    with FileLock(run / ".lock"):
        if identity(run / ".lock") not in held_locks():
            pytest.skip("this kernel does not show locks in /proc/locks")
        assert states(tmp_path)["a"].state == "in progress"
        assert states(tmp_path)["a"].left in ("3:19 min", "3:20 min")
    assert states(tmp_path)["a"].state == "stopped"
    (run / "metrics.json").write_text("{}")
    assert states(tmp_path)["a"].state == "finished"
    sketch = make_run(tmp_path / "stages" / "sketch-2", age_s=600)
    (sketch / "candidates-1").mkdir()
    assert states(tmp_path)["stages/sketch-2"].state == "stopped"
    (sketch / "candidates-1" / "metrics.json").touch()
    assert states(tmp_path)["stages/sketch-2"].state == "finished"
    recent = make_run(tmp_path / "b", age_s=60)  # in another container, whose locks are not seen
    assert states(tmp_path)[recent.name].state == "in progress"


def test_the_files_of_the_logger_itself_are_followed_line_by_line(tmp_path):
    logger = CSVLogger(tmp_path / "run", name=CSV, flush_logs_every_n_steps=1)
    logger.log_metrics({"train/loss": 4.0}, 9)
    assert states(tmp_path)["run"].step == 10
    logger.log_metrics({"val/rayiou": 0.25, "val/voxel/iou": float("nan")}, 19)
    assert details(tmp_path / "run")["curves"] == {"train/loss": [(9, 4.0)], "val/rayiou": [(19, 0.25)]}
    assert states(tmp_path)["run"].score == ("val/rayiou", 0.25)


def test_a_damaged_run_does_not_hide_the_others(tmp_path):
    make_run(tmp_path / "bad", "step,train/loss\n9,three\n")
    make_run(tmp_path / "good")
    (tmp_path / "good" / "config.yaml").write_text("{not: [yaml")
    assert states(tmp_path)["bad"].state == "unreadable"
    assert states(tmp_path)["good"].steps is None


def test_nothing_is_written(tmp_path):
    run = make_run(tmp_path / "a")
    (run / "images").mkdir()
    (run / "images" / "one.png").touch()

    def stamps():
        return {path: (path.stat().st_mtime_ns, path.stat().st_ctime_ns) for path in tmp_path.rglob("*")}

    before = stamps()
    run_states(tmp_path)
    details(run)
    jobs(tmp_path)
    assert stamps() == before


def test_the_newest_images_come_first_and_links_are_left_out(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(9):
        (folder / f"val-{k}.png").touch()
        os.utime(folder / f"val-{k}.png", (100 - k, 100 - k))
    (folder / "note.txt").touch()
    (folder / "link.png").symlink_to("/etc/hostname")
    assert last_images(tmp_path) == [f"val-{k}.png" for k in range(6)]


def test_long_curves_are_thinned_and_keep_their_last_point():
    points = thinned({step: step / 2 for step in range(0, 25030, 10)})
    assert len(points) <= 1000
    assert points[-1] == (25020, 12510.0)
    assert {b[0] - a[0] for a, b in itertools.pairwise(points)} == {30}
    assert thinned({3: 1.0}) == [(3, 1.0)]


def test_jobs_of_multiruns_say_what_they_do(tmp_path):
    folder = tmp_path / "sweeps" / "2026-01-01"
    folder.mkdir(parents=True)
    status = Status("running", "depth train", 3, 10, "steps", 2.0, 3.5)
    (folder / "0_ours.status.json").write_text(json.dumps(vars(status)))
    (folder / "1_mono.status.json").write_text("{")
    (folder / "2_old.status.json").write_text(json.dumps(vars(status)))
    os.utime(folder / "2_old.status.json", (0, 0))
    first, second = jobs(tmp_path)
    assert first == {"job": "0_ours", "status": "depth train: 3/10 steps, 2.0 steps/s, 0:03 min left"}
    assert "cannot be read" in second["status"]
