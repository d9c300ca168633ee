"""Hashes of the world's code, so that scenes that other code has rendered are not taken for its own."""

from pathlib import Path

from omniocc import seeding
from omniocc.code import code_fingerprint

FOLDER = Path(__file__).parent
BESIDE = (
    "fingerprint.py",
    "source.py",
    "drawn.py",
    "class_fractions.py",
    "command.py",
    "mask.py",
    "page.py",
    "plans.py",
)
"""Code beside the world's, which decides no content of a frame."""
EQUAL = {"63b8cb4388612acf": "4f35f93cc9fc00f7", "f1349faa8fd401f0": "9db84f4b5b033d9b"}
"""Hashes of code by those of code that makes equal frames to the last bit: that of before it moved here."""
VARIATIONS = "variations"
"""Subfolder of the world's code that counts in the fingerprint only of data that use it."""


def world_code() -> str:
    """Return a hash of the code that decides the content of every scene."""
    code = code_fingerprint(FOLDER, (VARIATIONS, *BESIDE), (Path(str(seeding.__file__)),))
    return EQUAL.get(code, code)


def variations_code() -> str:
    """Return a hash of the code of what only some options ask for."""
    code = code_fingerprint(FOLDER / VARIATIONS)
    return EQUAL.get(code, code)
