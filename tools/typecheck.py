"""Run tests with every shape annotation checked at run time, after a wrong shape has been seen to fail."""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = [f"tests/{name}" for name in ("camera", "loss", "model", "rayiou/raycast")]
GRIDS = ("dilate", "directions", "grid", "kernels", "resample", "surface", "vote", "warp")
FOLDERS += [f"tests/rayiou/test_{name}.py" for name in GRIDS]  # those of the metrics hand over wrong types on purpose
COMMAND = [sys.executable, "-m", "pytest", "-q", "-n", "auto", "-p", "no:cacheprovider", f"--rootdir={ROOT}"]
COMMAND += ["-c", str(ROOT / "pyproject.toml"), "--jaxtyping-packages=omniocc,rayiou,beartype.beartype"]
WRONG = """
import torch
from omniocc.geometry import Cylinder

def test_wrong():
    Cylinder((4, 8, 2), (0.0, 4.0), (-1.0, 1.0)).index(torch.zeros(5, 2))
"""


def refuses_a_wrong_shape() -> bool:
    """Return whether points of two instead of three coordinates end in an error about types; print the run if not."""
    with tempfile.TemporaryDirectory() as folder:
        wrong = Path(folder, "test_wrong.py")
        wrong.write_text(WRONG, encoding="utf-8")
        result = subprocess.run([*COMMAND, "-n0", str(wrong)], cwd=ROOT, capture_output=True, text=True, check=False)
    if result.returncode == 1 and ("TypeCheckError" in result.stdout or "Beartype" in result.stdout):
        return True
    print(result.stdout + result.stderr)
    return False


if __name__ == "__main__":
    if not refuses_a_wrong_shape():
        sys.exit("a wrong shape was not refused: annotations are not checked")
    sys.exit(subprocess.run([*COMMAND, "-m", "not slow", *FOLDERS], cwd=ROOT, check=False).returncode)
