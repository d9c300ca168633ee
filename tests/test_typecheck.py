"""Shape annotations are worth nothing unless something reads them."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
INSTRUMENT = ["--jaxtyping-packages=omniocc,beartype.beartype"]


def run_pytest(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_wrong_shape_must_fail_when_instrumented(tmp_path):
    wrong = tmp_path / "test_wrong.py"
    wrong.write_text(
        "import torch\n"
        "from omniocc.geometry import Cylinder\n"
        "def test_wrong():\n"
        "    Cylinder((4, 8, 2), (0.0, 4.0), (-1.0, 1.0)).index(torch.zeros(5, 2))\n"
    )
    result = run_pytest(*INSTRUMENT, "--rootdir", str(ROOT), "-c", str(ROOT / "pyproject.toml"), str(wrong))
    assert result.returncode == 1, result.stdout + result.stderr
    assert "TypeCheck" in result.stdout or "Beartype" in result.stdout, result.stdout


def test_the_contracts_hold_when_instrumented():
    folders = [f"tests/{name}" for name in ("camera", "geometry", "loss", "model")]
    result = run_pytest(*INSTRUMENT, "-x", "-m", "not slow", *folders)
    assert result.returncode == 0, result.stdout[-4000:]
