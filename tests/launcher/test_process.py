"""Tests of the launcher that runs the jobs of a multirun as processes."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from hydra_plugins.process_launcher.job import Job, file_name
from hydra_plugins.process_launcher.launcher import (
    ProcessLauncher,
    free_slots,
    left_s,
    progress,
    report,
    run_all,
    stop,
    summary,
    varying,
)
from omniocc.progress import Status

SRC = Path(__file__).parents[2] / "src"
WAITS = f"import sys, time, pathlib; sys.path.insert(0, {str(SRC)!r})\n" + (
    "from omniocc.progress import Progress\nprogress = Progress('rendering', 10)\n"
    "progress.wait('another process (pid 4711 on here) renders train-000, waiting')\n"
)
"""Code of a job that waits for another process; its wording plays no role."""


def job(folder: Path, label: str, code: str) -> Job:
    return Job(label, [sys.executable, "-u", "-c", code], folder / f"{label}.log")


def appears(path: Path, within_s: float = 20.0) -> bool:
    deadline_s = time.monotonic() + within_s
    while not path.exists() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return path.exists()


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").split()[2] != "Z"
    except FileNotFoundError:
        return False


def test_at_most_n_jobs_run_at_a_time(tmp_path):
    code = f"import time, pathlib; p = pathlib.Path({str(tmp_path)!r}); a = time.time(); time.sleep(0.6);" + (
        " print(a, time.time())"
    )
    jobs = [job(tmp_path, str(k), code) for k in range(4)]
    run_all(jobs, 2)
    spans = [tuple(map(float, j.last_lines(1)[0].split())) for j in jobs]
    most = max(sum(begin <= at < end for begin, end in spans) for at, _ in spans)
    assert most <= 2
    assert [j.code for j in jobs] == [0, 0, 0, 0]


def test_while_a_job_waits_for_another_the_next_one_starts(tmp_path):
    done = tmp_path / "done"
    waits = f"{WAITS}while not pathlib.Path({str(done)!r}).exists(): time.sleep(0.05)"
    jobs = [job(tmp_path, "waits", waits), job(tmp_path, "makes", f"open({str(done)!r}, 'w')")]
    run_all(jobs, 1)
    assert [j.code for j in jobs] == [0, 0]


def test_a_failure_stops_no_other_job_and_is_shown_with_its_last_lines(tmp_path):
    jobs = [job(tmp_path, "bad", "print('on the way'); raise SystemExit('no such grid')"), job(tmp_path, "good", "")]
    run_all(jobs, 1)
    text = summary(jobs, [j for j in jobs if j.code])
    assert "1 of 2 jobs" in text
    assert "bad (exit code 1)" in text
    assert "no such grid" in text
    assert "good" not in text.split("failed:")[1].splitlines()[0]


def test_progress_shows_finished_jobs_and_time_left(tmp_path):
    jobs = [job(tmp_path, "one", "print('stage 1')"), job(tmp_path, "two", "")]
    run_all(jobs[:1], 1)
    jobs[0].elapsed_s = 120.0
    assert progress(jobs, 1, 125.0) == "2:05 min: 1 of 2 jobs done, about 2:00 min left"


def test_time_left_is_at_least_that_of_a_running_job(tmp_path):
    jobs = [job(tmp_path, "done", ""), *(job(tmp_path, name, "import time; time.sleep(60)") for name in "abc")]
    run_all(jobs[:1], 1)
    jobs[0].elapsed_s = 600.0
    try:
        for running in jobs[1:3]:
            running.start({})
            running.started_s -= 540.0  # one minute less than the finished job took
        assert left_s(jobs, 2) == pytest.approx((60 + 60 + 600) / 2, abs=2)
        reported = Status(
            "running", "occupancy, stage 3 of 3 train", 107, 1000, "steps", rate_hz=0.571, left_s=26 * 60 + 3.0
        )
        jobs[1].status_file.write_text(json.dumps(asdict(reported)))
        assert left_s(jobs, 2) == pytest.approx(26 * 60 + 3)
        assert "a: occupancy, stage 3 of 3 train: 107/1000 steps, 1.75 s each, 26:03 min left" in progress(jobs, 2, 9.0)
    finally:
        stop(jobs)


def test_the_time_left_is_estimated_before_the_first_job_is_done(tmp_path):
    jobs = [job(tmp_path, name, "import time; time.sleep(60)") for name in "abcd"]
    try:
        for running, age_s in zip(jobs[:2], (300.0, 100.0), strict=True):
            running.start({})
            running.started_s -= age_s
        assert left_s(jobs, 2) is None
        assert "left" not in progress(jobs, 2, 300.0)
        jobs[0].status_file.write_text(
            json.dumps(asdict(Status("running", "depth", 1, 2, "steps", rate_hz=1.0, left_s=500.0)))
        )
        # the job takes 800 s: 500 are left of it, 700 of the second, 1600 of the two others
        assert left_s(jobs, 2) == pytest.approx((500 + 700 + 1600) / 2, abs=3)
        assert "about 23:" in progress(jobs, 2, 300.0)
    finally:
        stop(jobs)


def test_runs_that_were_finished_before_do_not_shorten_the_estimate(tmp_path):
    jobs = [job(tmp_path, name, "pass") for name in "abc"]
    for ended, elapsed_s in zip(jobs[:2], (600.0, 4.0), strict=True):
        ended.start({})
        ended.process.wait()
        ended.elapsed_s = elapsed_s
    assert left_s(jobs, 1) == pytest.approx(600, abs=2)


def test_the_number_of_waiting_jobs_is_limited(tmp_path):
    jobs = [job(tmp_path, str(number), f"{WAITS}time.sleep(60)") for number in range(5)]
    try:
        for number in range(4):
            assert free_slots(jobs, 2) == min(2, 4 - number)
            jobs[number].start({})
            assert appears(jobs[number].log)
            while not jobs[number].waiting:
                time.sleep(0.02)
        assert free_slots(jobs, 2) == 0
    finally:
        stop(jobs)


def test_the_output_of_a_job_is_not_parsed(tmp_path):
    says = "import time; print('x waits for another process that, left 99:00', flush=True); time.sleep(60)"
    jobs = [job(tmp_path, "x", says)]
    jobs[0].status_file.write_text(json.dumps(asdict(Status("waiting", "of an earlier run"))))
    try:
        jobs[0].start({})
        while not jobs[0].last_lines():
            time.sleep(0.02)
        assert not jobs[0].waiting
        assert progress(jobs, 1, 1.0) == "0:01 min: 0 of 1 jobs done | x: starting"
    finally:
        stop(jobs)


def test_jobs_end_when_their_parent_is_killed(tmp_path):
    child = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()) + '\\n'); time.sleep(60)"
    parent = (
        "import sys; from pathlib import Path; from hydra_plugins.process_launcher.job import Job\n"
        "from hydra_plugins.process_launcher.launcher import run_all\n"
        f"run_all([Job('x', [sys.executable, '-c', {child!r}], Path({str(tmp_path / 'log')!r}))], 1)"
    )
    process = subprocess.Popen([sys.executable, "-c", parent], env={**os.environ, "PYTHONPATH": str(SRC)})
    assert appears(tmp_path / "pid")
    time.sleep(0.1)
    pid = int((tmp_path / "pid").read_text())
    process.send_signal(signal.SIGKILL)
    process.wait()
    deadline_s = time.monotonic() + 10
    while alive(pid) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not alive(pid)


def test_an_interrupt_ends_all_jobs(tmp_path):
    jobs = [job(tmp_path, "long", f"import time; open({str(tmp_path / 'on')!r}, 'w'); time.sleep(60)")]
    alarm = signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    signal.setitimer(signal.ITIMER_REAL, 1.5)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_all(jobs, 1)
    finally:
        signal.signal(signal.SIGALRM, alarm)
    assert jobs[0].code is not None
    assert jobs[0].code != 0


def test_ctrl_c_ends_a_multirun_with_a_line(tmp_path, monkeypatch, capsys):
    def interrupted(jobs, n_jobs, start):
        raise KeyboardInterrupt

    monkeypatch.setattr("hydra_plugins.process_launcher.launcher.run_all", interrupted)
    launcher = ProcessLauncher(n_jobs=2)
    config = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path / "sweep")}}})
    launcher.setup(hydra_context=None, task_function=None, config=config)  # type: ignore[arg-type]
    with pytest.raises(SystemExit) as ended:
        launcher.launch([["+ablation=a"], ["+ablation=b"]], 0)
    assert ended.value.code == 130
    assert "stopped, 0 of 2 jobs are finished; the same command continues" in capsys.readouterr().out


def test_hydra_gets_one_result_per_job_and_exit_code_1_for_failures(tmp_path, monkeypatch, capsys):
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\nif __name__ == '__main__':\n    print(sys.argv[1:]); sys.exit('broken' in sys.argv[1])"
    )
    monkeypatch.setattr(sys, "argv", [str(script), "--multirun"])
    launcher = ProcessLauncher(n_jobs=2)
    config = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path / "sweep")}}})
    launcher.setup(hydra_context=None, task_function=None, config=config)  # type: ignore[arg-type]
    assert len(launcher.launch([["+ablation=a", "seed=1"], ["+ablation=b", "seed=1"]], 0)) == 2
    assert "'seed=1'" in (tmp_path / "sweep" / "000-a.log").read_text()
    with pytest.raises(SystemExit) as error:
        launcher.launch([["broken=1"], ["x=1"]], 2)
    assert error.value.code == 1
    assert "1 of 2 jobs finished" in capsys.readouterr().out


def test_a_script_that_cannot_be_imported_is_shown_once_for_every_job(tmp_path, monkeypatch, capsys):
    script = tmp_path / "script.py"
    script.write_text("import no_such_module")
    monkeypatch.setattr(sys, "argv", [str(script), "--multirun"])
    launcher = ProcessLauncher(n_jobs=1)
    config = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path / "sweep")}}})
    launcher.setup(hydra_context=None, task_function=None, config=config)  # type: ignore[arg-type]
    with pytest.raises(SystemExit):
        launcher.launch([["a=1"], ["a=2"]], 0)
    assert capsys.readouterr().out.count("No module named 'no_such_module'") == 2


def test_labels_and_log_names_distinguish_jobs():
    assert varying([["preset=tiny", "seed=0"], ["preset=tiny", "seed=1"]]) == {"seed=0", "seed=1"}
    assert varying([["seed=0"]]) == {"seed=0"}
    assert file_name("mono seed=1/../x", 3) == "003-mono_seed=1_.._x.log"


def test_zero_jobs_at_a_time_are_refused():
    with pytest.raises(ValueError, match="n_jobs=0"):
        ProcessLauncher(n_jobs=0)


def test_a_multirun_ends_with_the_scores_of_its_jobs(tmp_path, capsys):
    code = f"import sys; sys.path.insert(0, {str(SRC)!r})\n" + (
        "from pathlib import Path\nfrom omniocc.runs.results import save_results, show_results\n"
        "folder = Path({folder!r})\nfolder.mkdir(parents=True)\n"
        "save_results(folder, {{'test/rayiou': {score}, 'test/voxel/miou': float('nan')}}, {{}})\nshow_results(folder)"
    )
    scores = {"mono": 0.125, "omni": 0.25}
    jobs = [
        job(tmp_path, row, code.format(folder=str(tmp_path / "runs" / row), score=score))
        for row, score in scores.items()
    ]
    jobs.append(job(tmp_path, "without", ""))
    run_all(jobs, 3)
    report(jobs)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines if line.startswith(("mono", "omni", "without"))] == [
        ["mono", "0.125"],
        ["omni", "0.250"],
    ]
    assert f"python src/report.py --runs {tmp_path / 'runs'}" in "\n".join(lines)
