"""Run the jobs of a multirun as processes, show one line about all of them, list failures at the end."""

import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from hydra_plugins.process_launcher.job import Job, Starter, file_name, label_of, last_lines, start_command
from omniocc.errors import INTERRUPTED
from omniocc.progress import clock
from omniocc.runs.fork_server import ForkServer

POLL_S = 0.5
SEPARATOR = " | "  # between the jobs of the progress line; on a terminal each has a line of its own
LINE_EVERY_S = 60.0
GRACE_S = 20.0
IMPORTS = "imports.log"
"""Log file of the process that imports the script for all jobs."""
RESTED = 0.1
"""Fraction of the longest job's time below which a finished job had nothing to do, such as a run that was finished."""


class ProcessLauncher(Launcher):
    """Runs the jobs of a multirun as `python <script> <overrides>`, in the order given, with the imports done once.

    A failing job does not stop the others; its last lines are printed at the end and the exit code is 1. Jobs end with
    their parent. The script itself continues interrupted jobs and skips finished ones.

    Args:
        n_jobs: jobs at a time; while one waits for the result of another, the next one starts, up to `n_jobs` more.
            The cores are divided evenly by `OMP_NUM_THREADS`, unless it is set.
    """

    def __init__(self, n_jobs: int):
        if n_jobs < 1:
            raise ValueError(f"n_jobs={n_jobs}: give 1 or more")
        self.n_jobs = n_jobs
        self.folder = Path()

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep the folder of the logs; called by Hydra."""
        self.folder = Path(str(config.hydra.sweep.dir))

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run all jobs; end this process with exit code 1 if any fails, 130 after Ctrl-C."""
        self.folder.mkdir(parents=True, exist_ok=True)
        jobs = jobs_of(self.folder, job_overrides, initial_job_idx)
        print(f"{len(jobs)} jobs, {self.n_jobs} at a time; logs in {self.folder}", flush=True)
        server = ForkServer(Path(sys.argv[0]).resolve(), self.folder / IMPORTS)
        try:
            # a command is python, the script, and its arguments
            run_all(jobs, self.n_jobs, lambda command, *rest: server.start(command[2:], *rest))
        except KeyboardInterrupt:
            done = sum(job.code == 0 for job in jobs)
            print(f"\nstopped, {done} of {len(jobs)} jobs are finished; the same command continues", flush=True)
            sys.exit(INTERRUPTED)
        finally:
            server.close()
        report(jobs)
        return [JobReturn(overrides=list(o), status=JobStatus.COMPLETED) for o in job_overrides]


def jobs_of(folder: Path, job_overrides: Sequence[Sequence[str]], first: int) -> list[Job]:
    """Return the jobs of a multirun, numbered from `first`, with logs in a folder."""
    varied, script = varying(job_overrides), str(Path(sys.argv[0]).resolve())
    jobs = []
    for number, overrides in enumerate(job_overrides, start=first):
        label = label_of([o for o in overrides if o in varied]) or "job"
        jobs.append(Job(label, [sys.executable, script, *overrides], folder / file_name(label, number)))
    return jobs


def report(jobs: Sequence[Job]) -> None:
    """Print the scores of the jobs that finished and how the others ended; exit with code 1 if there are others."""
    failed = [job for job in jobs if job.code != 0]
    print(f"{scores(jobs)}{summary(jobs, failed)}", flush=True)
    if failed:
        sys.exit(1)


def scores(jobs: Sequence[Job]) -> str:
    """Return the scores of finished jobs as a table with the command that compares them; empty where none has any."""
    from omniocc.runs.results import MINUTES, load_results  # Hydra imports this module at every start of a script
    from omniocc.runs.table import comparison_cells, in_columns

    folders = {
        job.label: Path(job.status.results) for job in jobs if job.code == 0 and job.status and job.status.results
    }
    results = {label: load_results(folder) for label, folder in folders.items()}
    results = {label: (facts, metrics) for label, (facts, metrics) in results.items() if "test/rayiou" in metrics}
    if not results:
        return ""
    head, lines = comparison_cells({label: (metrics, "test") for label, (_, metrics) in results.items()})
    minutes = [f"{facts[MINUTES]:.0f}" if MINUTES in facts else "–" for facts, _ in results.values()]
    table = in_columns(
        ["job", *head[1:], "minutes"], [[*line, each] for line, each in zip(lines, minutes, strict=True)]
    )
    runs = folders[next(iter(results))].parent
    return f"\n{table}\n\nmeans over seeds, errors and plots: python src/report.py --runs {runs}\n\n"


def varying(job_overrides: Sequence[Sequence[str]]) -> set[str]:
    """Return the overrides that not all jobs share; all of them if there is only one job."""
    shared = set.intersection(*map(set, job_overrides)) if len(job_overrides) > 1 else set()
    return {override for overrides in job_overrides for override in overrides} - shared


def run_all(jobs: Sequence[Job], n_jobs: int, start: Starter = start_command) -> None:
    """Start jobs as others end, and show their progress, until all have ended."""
    from rich.console import Console  # Hydra imports this module at every start of a script

    threads = str(max(1, (os.cpu_count() or 1) // n_jobs))
    environment = {} if "OMP_NUM_THREADS" in os.environ else {"OMP_NUM_THREADS": threads}
    console = Console()
    started_s = printed_s = time.monotonic()
    try:
        with console.status("") as status:
            while any(job.code is None for job in jobs):
                for job in [job for job in jobs if job.process is None][: free_slots(jobs, n_jobs)]:
                    job.start(environment, start)
                line = progress(jobs, n_jobs, time.monotonic() - started_s)
                status.update(line.replace(SEPARATOR, "\n  "))
                if not console.is_terminal and time.monotonic() - printed_s > LINE_EVERY_S:
                    printed_s = time.monotonic()
                    print(line, flush=True)
                time.sleep(POLL_S)
    finally:
        stop(jobs)


def free_slots(jobs: Sequence[Job], n_jobs: int) -> int:
    """Return the number of jobs that may start now.

    Waiting jobs are replaced, but at most `n_jobs` of them, since all of them will run at once later.
    """
    running = sum(job.running for job in jobs)
    waiting = sum(job.waiting for job in jobs)
    return max(0, n_jobs + min(waiting, n_jobs) - running)


def stop(jobs: Sequence[Job]) -> None:
    """End the running jobs: with SIGINT as Ctrl-C does, then with SIGTERM, then with SIGKILL."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for job in jobs:
            job.send_signal(number)
        deadline_s = time.monotonic() + GRACE_S
        while any(job.group for job in jobs) and time.monotonic() < deadline_s:
            time.sleep(0.1)


def progress(jobs: Sequence[Job], n_jobs: int, elapsed_s: float) -> str:
    """Return one line: how many jobs are done, the time left, what each running job reports."""
    done = [job for job in jobs if job.code is not None]
    failed = sum(job.code != 0 for job in done)
    seconds = left_s(jobs, n_jobs)
    left = "" if seconds is None else f", about {clock(seconds)} left"
    parts = [f"{len(done)} of {len(jobs)} jobs done{f', {failed} failed' if failed else ''}{left}"]
    parts += [f"{job.label}: {job.status or 'starting'}" for job in jobs if job.running]
    return SEPARATOR.join([f"{clock(elapsed_s)}: {parts[0]}", *parts[1:]])


def expected_s(jobs: Sequence[Job]) -> float | None:
    """Return how long a job is expected to take, s; None as long as nothing is known.

    That is the mean of the finished ones, without those that had nothing left to do. Before the first is finished, it
    is the mean of what the running ones report of their present stage.
    """
    ages_s = [job.age_s for job in jobs if job.running]
    finished_s = [job.elapsed_s for job in jobs if job.code is not None]
    worked_s = [seconds for seconds in finished_s if seconds >= RESTED * max([*finished_s, *ages_s])]
    if worked_s:
        return sum(worked_s) / len(worked_s)
    reports = [(job.age_s, job.status) for job in jobs if job.running and not job.waiting]
    guesses_s = [age_s + status.left_s for age_s, status in reports if status is not None and status.left_s is not None]
    return sum(guesses_s) / len(guesses_s) if guesses_s else None


def left_s(jobs: Sequence[Job], n_jobs: int) -> float | None:
    """Return the estimated seconds until all jobs are done; None as long as nothing is known.

    Each job takes as long as `expected_s`, or longer if it reports so.
    """
    each_s = expected_s(jobs)
    if each_s is None:
        return None
    reports = [(job, job.status) for job in jobs if job.running]
    running = [max(each_s - job.age_s, (status and status.left_s) or 0.0) for job, status in reports]
    pending_s = each_s * sum(job.process is None for job in jobs)
    return max([(sum(running) + pending_s) / n_jobs, *running])


def summary(jobs: Sequence[Job], failed: Sequence[Job]) -> str:
    """Return how many jobs finished, and the last lines of those that failed."""
    lines = [f"{len(jobs) - len(failed)} of {len(jobs)} jobs finished"]
    for job in failed:
        lines += [f"\nfailed: {job.label} (exit code {job.code}), {job.log}"]
        lines += [f"  {line}" for line in job.last_lines() or last_lines(job.log.with_name(IMPORTS))]
        lines += [f"  again: {' '.join(job.command)}"]
    return "\n".join(lines)
