"""Helpers of the tests in a browser, which make the same pages."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "browser"))
