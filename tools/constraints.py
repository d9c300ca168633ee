"""Write `constraints.txt` from `pyproject.toml`, or check that its pins can be installed on every Python supported.

python tools/constraints.py           keep the pins there are, add and drop what `pyproject.toml` asks for
python tools/constraints.py upgrade   take the newest version of everything but torch
python tools/constraints.py check     check that every pin has a wheel for every Python supported
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = ROOT / "constraints.txt"
TORCH = "torch==2.13.0"
HEADER = """\
# Versions this release is tested with, on Linux x86-64. Do not edit by hand: `make constraints` writes this file
# (uv pip compile of pyproject.toml, extra dev, one answer for all Pythons supported). torch is pinned without a build
# tag: the CPU or the CUDA build of that version, whichever your index serves; its CUDA build pins what it needs.
"""
HERE = " ; platform_machine == 'x86_64' and sys_platform == 'linux'"  # `tool.uv.environments`, the same on every line
LEFT_OUT = re.compile(r"(nvidia-|cuda-|triton==|-e )")  # what only CUDA needs, and our own package
SOURCE_ONLY = ("antlr4-python3-runtime",)  # pure Python, published without a wheel


def pythons() -> list[str]:
    """Return the Python versions in the classifiers of `pyproject.toml`, oldest first."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return [entry.rsplit(" ", 1)[1] for entry in project["classifiers"] if " :: Python :: 3." in entry]


def compiled(*arguments: str) -> str:
    """Return what `uv pip compile` resolves for the given arguments; end with its message if it cannot."""
    command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate", *arguments]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if result.returncode:
        sys.exit(result.stderr)
    return result.stdout


def write(upgrade: bool) -> None:
    """Resolve once for all Pythons supported and write the pins, a marker where they differ."""
    with tempfile.TemporaryDirectory() as folder:
        torch, pins = Path(folder, "torch.txt"), Path(folder, "pins.txt")
        torch.write_text(TORCH, encoding="utf-8")
        pins.write_text("" if upgrade else FILE.read_text(), encoding="utf-8")
        compiled(
            "pyproject.toml",
            "--extra=dev",
            "--universal",
            f"--python-version={pythons()[0]}",
            f"--constraint={torch}",
            f"--output-file={pins}",
        )
        lines = [
            line.removesuffix(HERE)
            for line in pins.read_text(encoding="utf-8").splitlines()
            if not LEFT_OUT.match(line)
        ]
    FILE.write_text(HEADER + "\n".join(lines) + "\n")
    print(f"{FILE.name}: {len(lines)} versions")


def check() -> None:
    """Look every pin up for every Python supported, wheels alone; nothing is downloaded but their descriptions."""
    for python in pythons():
        source = [f"--no-binary={name}" for name in SOURCE_ONLY]
        found = compiled(
            FILE.name,
            "--no-deps",
            "--only-binary=:all:",
            *source,
            f"--python-version={python}",
            "--python-platform=x86_64-manylinux_2_28",
        )
        print(f"Python {python}: wheels of {len(found.splitlines())} versions")


if __name__ == "__main__":
    mode = sys.argv[1] if len(sys.argv) > 1 else ""
    if mode not in ("", "upgrade", "check"):
        sys.exit(f"{mode}: choose one of upgrade, check")
    check() if mode == "check" else write(mode == "upgrade")
