"""End with one line if this Python is none of those that `pyproject.toml` supports (old ones can run this)."""

import os
import re
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def main():
    """Compare the running Python with `requires-python`."""
    with open(os.path.join(ROOT, "pyproject.toml"), encoding="utf-8") as file:
        low, high = map(int, re.search(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', file.read()).groups())
    if not (3, low) <= sys.version_info[:2] < (3, high):
        found = "Python " + ".".join(map(str, sys.version_info[:3])) + " (" + sys.executable + ") found"
        needed = "3." + str(low) + " to 3." + str(high - 1) + " needed"
        sys.exit(found + ", " + needed + ": make setup PYTHON=python3.12")


main()
