"""Open hostile files of every kind by every command that reads them; `make test-hostile`, HOSTILE_SEED=0.

A command must refuse such a file in one error that names it, or read what is right in it. It must not run code, write
outside its folder, end with a traceback, hang, take all memory, or succeed with a wrong value. A test is a file; its
name is the mutation.
"""

import importlib
import json
import os
import random
import shlex
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest
from sandbox import Box, Case

SEED = int(os.environ.get("HOSTILE_SEED", "0"))
FORGES = (
    "forge_checkpoints",
    "forge_rigs",
    "forge_poses",
    "forge_clouds",
    "forge_scenes",
    "forge_datasets",
    "forge_reports",
    "forge_archives",
    "forge_bags",
)
MOST = {
    "checkpoints": 60,
    "scenes and shards": 64,
    "point clouds": 74,
    "rigs and calibrations": 56,
    "files of poses and times": 30,
    "dataset files": 156,
    "folders of runs": 44,
    "archives of runs": 20,
    "bags": 24,
}
"""Files of each kind that one seed opens; HOSTILE_ALL=1 opens all."""


def drawn(cases: Sequence[Case], seed: int) -> list[Case]:
    """Return as many cases of each kind as `MOST` says, others for another seed."""
    if os.environ.get("HOSTILE_ALL") == "1":
        return list(cases)
    rng, found = random.Random(seed), []
    for kind, most in MOST.items():
        own = [case for case in cases if case.kind == kind]
        found += rng.sample(own, min(most, len(own)))
    return found


CASES = drawn([case for name in FORGES for case in importlib.import_module(name).cases(SEED)], SEED)
pytestmark = pytest.mark.hostile


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.kind}-{case.name}")
def test_file(case: Case, base: Path, tmp_path_factory, record_property) -> None:
    folder = tmp_path_factory.mktemp("b")  # a short name: sockets below it have paths of 108 bytes at most
    box = Box(folder, base, folder.parent)
    openings = case.make(box)
    assert openings
    record_property("hostile", json.dumps([case.kind, len(openings)]))
    faults = [(one, fault) for one in openings for fault in box.problems(one)]
    if faults:
        place = str(box.folder)
        lines = [
            f"{' '.join(one.command[:2] if one.command[0] == 'predict.py' else one.command[:1])}: {fault}"
            for one, fault in faults
        ]
        commands = [shlex.join(one.command) for one, _ in faults]
        text = "\n".join([" | ".join(dict.fromkeys(lines)), *dict.fromkeys(commands)])
        pytest.fail(text.replace(place, "..").replace(str(base), "BASE"), pytrace=False)
    shutil.rmtree(folder)


def test_there_are_enough_files() -> None:
    wanted = {
        "checkpoints": 40,
        "scenes and shards": 60,
        "point clouds": 70,
        "rigs and calibrations": 50,
        "files of poses and times": 20,
        "dataset files": 150,
        "folders of runs": 40,
        "archives of runs": 15,
        "bags": 20,
    }
    found = Counter(case.kind for case in CASES)
    assert found.keys() == wanted.keys()
    assert all(found[kind] >= least for kind, least in wanted.items()), found
