"""Help and mistyped keys are answered before anything large is imported."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from omniocc.commands.evaluate import KINDS, ORIGINS
from omniocc.data.origins import Origins
from omniocc.extras.robustness.parts import UNSEEN, parts_of

SRC = Path(__file__).parents[1] / "src"
LARGE = ("torch", "lightning", "wandb", "cv2", "scipy", "torchmetrics", "transformers", "numba", "numpy", "jinja2")
COUNTED = f"""
import atexit, json, runpy, sys
atexit.register(lambda: print("\\n" + json.dumps([name for name in {LARGE} if name in sys.modules])))
sys.argv = sys.argv[1:]
sys.path[0] = {str(SRC)!r}
runpy.run_path(sys.argv[0], run_name="__main__")
"""
COMPOSED = [("train",), ("render",), ("export",), ("mask",), ("record",), ("view",), ("rig", "new"), ("rig", "show")]
COMPOSED += [("predict", kind) for kind in ("depth", "occupancy", "submission")]
HELPED = [*COMPOSED, *((path.stem,) for path in sorted(SRC.glob("*.py")) if (path.stem,) not in COMPOSED)]


def imported(*words: str) -> tuple[int, list[str]]:
    """Return the exit code of a command, and which large packages it has imported."""
    name, *others = words
    command = [sys.executable, "-c", COUNTED, str(SRC / f"{name}.py"), *others]
    environment = {**os.environ, "PYTHONPATH": str(SRC)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow(20)
def test_help_and_mistyped_keys_import_nothing_large():
    commands = {(*words, "--help"): 0 for words in HELPED} | {("train", "--cfg", "job"): 0}
    commands |= {(*words, "modle=x"): 1 for words in [*COMPOSED, ("check",)]} | {("predict", "occupancy"): 1}
    assert len(commands) > 25
    assert {words: imported(*words) for words in commands} == {words: (code, []) for words, code in commands.items()}


def test_the_choices_that_the_help_of_evaluate_lists_are_all():
    assert get_args(Origins) == ORIGINS
    assert list(dict.fromkeys(part.group for part in parts_of(("front", "left", "rear"), (UNSEEN,))[1:])) == list(KINDS)
