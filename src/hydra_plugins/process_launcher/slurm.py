"""Run the jobs of a multirun as Slurm jobs, show one line about all of them, list failures at the end."""

import contextlib
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from types import FrameType
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from hydra_plugins.process_launcher.job import Job
from hydra_plugins.process_launcher.launcher import INTERRUPTED, jobs_of, report, run_all
from omniocc.errors import UserError, installing
from omniocc.io import atomic_write
from omniocc.progress import STATUS_FILE

STOP = signal.SIGUSR2
"""Signal that Slurm sends some time before the limit, and that training answers with a checkpoint (`StopAtSignal`)."""
MARGIN_S = 30.0
"""Time before the limit at which a command that has not ended by itself is ended, s."""
POLL_S = 0.5
LIMIT = os.EX_TEMPFAIL
"""Exit code of a command that has reached the time limit too often."""


class SlurmJob:
    """Run a command in a Slurm job and leave its exit code in a file; before the time limit let it stop, and requeue.

    submitit pickles this object and calls it in every task of the job.

    Args:
        command: program and arguments.
        log: file of its output, continued if it exists; tasks after the first have one each beside it.
        environment: further variables.
        warning_s: time between Slurm's signal and the limit, s.
    """

    def __init__(self, command: Sequence[str], log: Path, environment: Mapping[str, str], warning_s: float):
        self.command, self.log, self.environment = list(command), log, dict(environment)
        self.patience_s = max(1.0, warning_s - MARGIN_S)
        self.signalled_s: float | None = None

    def __call__(self) -> None:
        """Run the command and end with its exit code; a command that the limit stopped is queued again."""
        task = int(os.environ.get("SLURM_PROCID", "0"))
        code_file(self.log, task).unlink(missing_ok=True)
        requeue = signal.signal(STOP, self._note)
        with log_of(self.log, task).open("ab") as output:
            child = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **self.environment},
                preexec_fn=_ignore_stop,
            )
        code = self._wait(child)
        if self.signalled_s is not None and code != 0 and callable(requeue):
            code = self._queue_again(requeue, task)
        if code is not None:
            atomic_write(code_file(self.log, task), f"{code}\n")
        sys.exit(code or 0)  # so that Slurm knows too

    def checkpoint(self) -> Any:
        """Return what is run after the requeue: the same command."""
        from submitit.helpers import DelayedSubmission

        self.signalled_s = None
        return DelayedSubmission(self)

    def _queue_again(self, requeue: Callable[[int, None], Any], task: int) -> int | None:
        """Let submitit queue the job again, which ends the first task; return a code if it refuses."""
        signal.signal(STOP, signal.SIG_IGN)
        try:
            requeue(STOP, None)
        except RuntimeError as error:
            with log_of(self.log, task).open("a", encoding="utf-8") as output:
                output.write(f"the time limit of the Slurm job is reached: {error} The same command goes on.\n")
            return LIMIT
        return None

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signalled_s = time.monotonic()

    def _wait(self, child: subprocess.Popen) -> int:
        told = False
        while (code := child.poll()) is None:
            if self.signalled_s is not None:
                if not told:
                    child.send_signal(STOP)
                    told = True
                if time.monotonic() - self.signalled_s > self.patience_s:
                    child.kill()
            time.sleep(POLL_S)
        return code


def log_of(log: Path, task: int) -> Path:
    """Return the file of the output of one task of a job."""
    return log if task == 0 else log.with_suffix(f".task{task}{log.suffix}")


def code_file(log: Path, task: int) -> Path:
    """Return the file with the exit code of one task of a job."""
    return log_of(log, task).with_suffix(".code")


def _ignore_stop() -> None:
    """Ignore the signal in the child until it is ready for it: Slurm sends it to every process of a job."""
    with contextlib.suppress(ValueError):
        signal.signal(STOP, signal.SIG_IGN)


ASK_EVERY_S = 10.0
GONE_S = 30.0
"""Time for the exit code of a job that Slurm has ended to appear on a shared file system, s."""
ENDED = ("COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "OUT_OF_MEMORY", "NODE_FAIL", "BOOT_FAIL", "DEADLINE")
LOST = os.EX_SOFTWARE
"""Exit code of a job that left none."""


class SlurmLauncher(Launcher):
    """Runs each job of a multirun as `python <script> <overrides>` in a Slurm job of its own, all in one array.

    A failing job does not stop the others; its last lines are printed at the end and the exit code is 1. A job that
    reaches its time limit is queued again and continues. The jobs go on when this process ends.

    Args:
        nodes: machines of each job.
        tasks_per_node: processes on each machine (`trainer.devices`).
        gpus_per_node: GPUs of each machine; None: none are asked for.
        cpus_per_task: cores of each process.
        mem_gb: memory of each machine, GB; None: the cluster's default.
        timeout_min: time limit, minutes.
        signal_delay_s: time before the limit at which training saves a checkpoint and stops, s.
        requeues: how often a job that reaches its limit is queued again.
        array_parallelism: jobs at a time.
        partition: of the cluster; None: its default.
        account: to charge; None: the default.
        qos: quality of service; None: the default.
        constraint: features of the machines; None: any.
        setup: shell commands before the job, such as `module load cuda`.
        sbatch: further options of sbatch by name, such as `{exclude: node07}`.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(
        self,
        nodes: int,
        tasks_per_node: int,
        gpus_per_node: int | None,
        cpus_per_task: int,
        mem_gb: float | None,
        timeout_min: int,
        signal_delay_s: int,
        requeues: int,
        array_parallelism: int,
        partition: str | None,
        account: str | None,
        qos: str | None,
        constraint: str | None,
        setup: Sequence[str],
        sbatch: Mapping[str, Any],
    ):
        for name, value in (("nodes", nodes), ("tasks_per_node", tasks_per_node), ("timeout_min", timeout_min)):
            if value < 1:
                raise ValueError(f"{name}={value}: give 1 or more")
        self.tasks, self.warning_s, self.requeues = nodes * tasks_per_node, float(signal_delay_s), requeues
        asked = {"slurm_partition": partition, "slurm_account": account, "slurm_qos": qos}
        asked |= {"slurm_constraint": constraint, "gpus_per_node": gpus_per_node, "mem_gb": mem_gb}
        self.parameters = {key: value for key, value in asked.items() if value is not None} | {
            "nodes": nodes,
            "tasks_per_node": tasks_per_node,
            "cpus_per_task": cpus_per_task,
            "timeout_min": timeout_min,
            "slurm_signal_delay_s": signal_delay_s,
            "stderr_to_stdout": True,
            "slurm_array_parallelism": array_parallelism,
            "slurm_setup": list(setup),
            "slurm_additional_parameters": dict(sbatch),
        }
        self.folder, self.name = Path(), ""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep the folder of the logs; called by Hydra."""
        self.folder, self.name = Path(str(config.hydra.sweep.dir)).absolute(), str(config.hydra.job.name)

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Submit all jobs and wait for them; end this process with exit code 1 if any fails, 130 after Ctrl-C."""
        self.folder.mkdir(parents=True, exist_ok=True)
        jobs = jobs_of(self.folder, job_overrides, initial_job_idx)
        ids = dict(zip((job.log for job in jobs), self._submit(jobs), strict=True))
        array = next(iter(ids.values())).split("_")[0]
        print(f"{len(jobs)} jobs, number {array} in Slurm; logs in {self.folder}", flush=True)
        queue = Queue(array)
        try:
            run_all(jobs, len(jobs), lambda command, environment, log: Submitted(queue, ids[log], log, self.tasks))
        except KeyboardInterrupt:
            print(f"\nthe jobs go on; 'scancel {array}' ends them; 'python src/report.py' shows what is finished")
            sys.exit(INTERRUPTED)
        report(jobs)
        return [JobReturn(overrides=list(o), status=JobStatus.COMPLETED) for o in job_overrides]

    def _submit(self, jobs: Sequence[Job]) -> list[str]:
        """Return the number of every job, `<array>_<place>`."""
        if shutil.which("sbatch") is None:
            raise UserError(
                "hydra/launcher=slurm needs Slurm, whose sbatch is not here; hydra/launcher=process needs nothing"
            )
        try:
            from submitit import AutoExecutor
            from submitit.core.utils import FailedJobError
        except ImportError as error:
            raise UserError(f"hydra/launcher=slurm needs submitit: {installing('cluster')}") from error
        executor = AutoExecutor(self.folder / "slurm", cluster="slurm", slurm_max_num_timeout=self.requeues)
        executor.update_parameters(name=self.name, **self.parameters)
        try:
            with redirect_stderr(StringIO()), executor.batch():  # sbatch's message is in the error
                submitted = [executor.submit(work) for work in map(self._work, jobs)]
        except FailedJobError as error:
            raise UserError(f"sbatch refuses: {refusal(str(error))}") from error
        return [job.job_id for job in submitted]

    def _work(self, job: Job) -> SlurmJob:
        return SlurmJob(job.command, job.log, {STATUS_FILE: str(job.status_file)}, self.warning_s)


class Queue:
    """What Slurm says of the jobs of an array; it is asked every ten seconds at most."""

    def __init__(self, array: str):
        self.array, self.states, self.asked_s = array, {}, -math.inf

    def state(self, number: str) -> str:
        """Return the state of a job as squeue names it; empty if Slurm does not list it any more."""
        if time.monotonic() - self.asked_s > ASK_EVERY_S:
            command = ["squeue", "--noheader", "--array", "--states=all", f"--jobs={self.array}", "--format=%i %T"]
            answer = subprocess.run(command, capture_output=True, text=True, check=False)
            if answer.returncode == 0 or "Invalid job id" in answer.stderr:  # else Slurm does not answer for a while
                self.states = dict(line.split() for line in answer.stdout.splitlines())
            self.asked_s = time.monotonic()
        return self.states.get(number, "")


class Submitted:
    """A submitted job as a process that the launcher watches.

    Args:
        queue: what Slurm says of it.
        number: its number there.
        log: file of its output.
        tasks: processes that it has.
    """

    pid = None

    def __init__(self, queue: Queue, number: str, log: Path, tasks: int):
        self.queue, self.number, self.log = queue, number, log
        self.codes = [code_file(log, task) for task in range(tasks)]
        self.ended_s: float | None = None
        self.lost = False

    def poll(self) -> int | None:
        """Return the exit code, that of a task which failed if any; None before the end."""
        if all(path.exists() for path in self.codes):
            codes = [int(path.read_text("utf-8") or LOST) for path in self.codes]
            return next((code for code in codes if code), 0)
        if self.lost:
            return LOST
        state = self.queue.state(self.number)
        if state and state not in ENDED:
            self.ended_s = None
            return None
        self.ended_s = self.ended_s or time.monotonic()
        if time.monotonic() - self.ended_s < GONE_S:
            return None
        self.lost = True
        with self.log.open("a", encoding="utf-8") as file:
            file.write(f"Slurm ended job {self.number}: {state or 'it is not listed any more'}\n")
        return LOST


def refusal(text: str) -> str:
    """Return the last line of sbatch's message about a job that it does not take."""
    lines = [line.strip() for line in text.splitlines() if "error" in line.lower()]
    return (lines or text.strip().splitlines() or ["it gives no reason"])[-1].removeprefix("sbatch: error: ")
