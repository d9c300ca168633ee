"""One of three runs is damaged in every file and value that it has: reports and the watching server keep the others."""

import importlib.util
import json
import math
import os
import shutil
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import yaml
from fake_scene import FakeWorld
from fake_sweep import CYLINDER, OMNI, report, write_run

from omniocc.bounds import fits
from omniocc.extras.viewer.watch.server import answer
from omniocc.runs.results import FROM_TRAJECTORY, HINTS
from omniocc.runs.robustness import PartScores, Robustness, save_robustness
from omniocc.runs.scenes import save_scenes

ROOT = Path(__file__).parents[2]
BAD, SOUND = "ours-00000002", ("ours-00000001", "my_own-00000001")
CONFIG, METRICS, SCENES, CURVES = "config.yaml", "metrics.json", "scenes.json", "csv/version_0/metrics.csv"
LATER, TESTS = f"{FROM_TRAJECTORY}/metrics.json", "robustness-best/robustness.json"
FILES = (CONFIG, METRICS, SCENES, CURVES, LATER, TESTS)
MISSING = object()
VALUES = {
    "a text": "many",
    "a number": 7.5,
    "a list": ["a", 1],
    "keys": {"a": 1},
    "null": None,
    "true": True,
    "nan": math.nan,
    "negative": -3,
    "huge": 10**400,
    "large": 1e300,
    "a date": date(2024, 1, 1),
    "missing": MISSING,
}
"""What stands in place of a value."""
CONTENTS = {
    "empty": b"",
    "binary": bytes(range(256)) * 4,
    "zeros": bytes(4096),
    "a list": b"[1, 2]\n",
    "a text": b'"text"\n',
    "a number": b"7\n",
    "null": b"null\n",
    "deep": b"[" * 20_000,
    "no text": b"\xff\xfea: 1\n",
}
"""What stands in place of the content of a file."""


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def as_loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


def as_broken_disk(path: Path) -> None:
    """Replace a file by one that cannot be read, by root neither."""
    path.unlink()
    path.symlink_to("/proc/self/mem")


def as_secret(path: Path) -> None:
    path.chmod(0)


PLACES = {"folder": as_folder, "loop": as_loop, "broken disk": as_broken_disk}
PLACES |= {"secret": as_secret} if os.geteuid() else {}  # root reads everything
KINDS = [*CONTENTS, "cut", *PLACES]


@pytest.fixture(scope="module")
def three(tmp_path_factory) -> Path:
    """Folder of three runs, with every file that a run can have: two seeds of a row, and a run of no table."""
    root = tmp_path_factory.mktemp("three")
    world = FakeWorld(str(root / "data"))
    world.prepare()
    for seed, name in enumerate((SOUND[0], BAD, SOUND[1])):
        folder = root / "runs" / name
        write_run(folder, seed, 0.3 + seed / 100, world, OMNI, CYLINDER)
        tree = yaml.safe_load((folder / CONFIG).read_text())
        more = {
            "preset": {"name": "mine"},
            "stages": {"occupancy": {"max_steps": 40, "batch_size": 2}},
            "packages": ["me"],
        }
        more |= {"optimizer": {"learning_rate": 0.003}, "name": "ours"}
        (folder / CONFIG).write_text(yaml.safe_dump(tree | more))
        rays = [[9, 8], [7, 9], [6, 5]]
        scene = {"rays": rays, "lidar": rays, "moving": rays}
        weather = {"weather": "rain"}
        save_scenes(folder, {"a": scene, "b": scene}, {"a": weather, "b": weather}, ["Free", "Road"], [1.0])
        facts = json.loads((folder / METRICS).read_text())
        facts |= {"machine": "x86_64", "peak MiB": 100.0, "finished": "2026-11-25T16:30:00Z"}
        facts |= {"minutes of earlier stages": 1.0, "million parameters": 1.0, "GFLOP a frame": 2.0}
        facts["metrics"]["val/rayiou"] = 0.2
        (folder / METRICS).write_text(json.dumps(facts))
        (folder / FROM_TRAJECTORY).mkdir()
        later = facts | {"overrides": [], "metrics": {"test/rayiou": 0.1, "test/rayiou_past": 0.2}}
        (folder / LATER).write_text(json.dumps(later))
        parts = [
            PartScores(name, group, ["a", "b"], 2, 1.0, {"rayiou": score}, without={"rayiou": [score] * 2})
            for name, group, score in (("undisturbed", "undisturbed", 0.5), ("view_90_deg", "view", 0.3))
        ]
        more = {"setting": "one", "seed": 0, "left out": ["nothing"], "command": "evaluate.py"}
        save_robustness(folder / Path(TESTS).parent, Robustness(folder.name, more, parts))
    return root / "runs"


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> Path:
    """Folder of a few of the tables."""
    folder = tmp_path_factory.mktemp("sweeps")
    for name in ("sketch", "dataset", "weather", "bets"):
        shutil.copy(ROOT / "sweeps" / f"{name}.yaml", folder)
    return folder


def places_in(tree: Any, path: tuple = ()) -> Iterator[tuple]:
    """Yield the path of every value in a plain tree, of a list's values that of the first."""
    if path:
        yield path
    items = tree.items() if isinstance(tree, dict) else enumerate(tree[:1]) if isinstance(tree, list) else ()
    for key, value in items:
        yield from places_in(value, (*path, key))


def put(tree: Any, path: tuple, value: Any) -> None:
    for key in path[:-1]:
        tree = tree[key]
    if value is MISSING:
        del tree[path[-1]]
    else:
        tree[path[-1]] = value


def read(path: Path) -> Any:
    return (
        yaml.safe_load(path.read_text(encoding="utf-8"))
        if path.suffix == ".yaml"
        else json.loads(path.read_text(encoding="utf-8"))
    )


def damage(folder: Path, file: str, kind: str, place: tuple) -> bool:
    """Damage a file of a run, whole or the value at a place in it; return whether its report has to name it."""
    path = folder / file
    if not place:
        if kind in PLACES:
            PLACES[kind](path)
        else:
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2] if kind == "cut" else CONTENTS[kind])
        # a file of curves without a whole line is one that is being written, and half a YAML file may be a whole one
        return kind in (*PLACES, "binary", "no text", "zeros") or (file != CURVES and (file, kind) != (CONFIG, "cut"))
    tree = read(path)
    put(tree, place, VALUES[kind])
    path.write_text(yaml.safe_dump(tree) if path.suffix == ".yaml" else json.dumps(tree, default=str))
    hint = HINTS.get(str(place[0])) if file in (METRICS, LATER) and len(place) == 1 else None
    return VALUES[kind] is not MISSING and hint is not None and not fits(read(path)[place[0]], hint)


WHOLE = [(file, "") for file in FILES]
PARTS = [(file, kind) for file in FILES if file != CURVES for kind in VALUES]


@pytest.mark.slow(2)
@pytest.mark.parametrize(("file", "kind"), WHOLE + PARTS)
def test_a_damaged_run_is_named_and_leaves_the_others(file, kind, three, tables, tmp_path, capsys, monkeypatch):
    """Every damage has a run of its own beside two sound ones, so that one report and one list of runs tells of all."""
    find_spec = importlib.util.find_spec  # plots take most of the time
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find_spec(name))
    runs, must = shutil.copytree(three, tmp_path / "runs"), {}
    damages = [(kind, place) for place in places_in(read(runs / BAD / file))] if kind else [(one, ()) for one in KINDS]
    for number, one in enumerate(damages, 2):
        name = f"ours-{number:08x}"
        if name != BAD:
            shutil.copytree(three / BAD, runs / name)
            facts = json.loads((runs / name / METRICS).read_text())
            (runs / name / METRICS).write_text(json.dumps(facts | {"seed": number}))
        must[name] = damage(runs / name, file, *one)
    capsys.readouterr()
    output = tmp_path / "report"
    report("--runs", str(runs), "--sweeps", str(tables), "--output", str(output), "--docs", str(output / "docs"))
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("left out: ")]
    pages = "".join(path.read_text("utf-8") for path in output.rglob("index.html"))
    assert [name for name in SOUND if f">{name}<" not in pages] == []
    damage_of = dict(zip(must, damages, strict=True))
    named = {name for name in must if any(f"{runs / name / file}" in line for line in told)}
    assert [damage_of[name] for name in must if must[name] and name not in named] == []
    assert [damage_of[name] for name in must if name not in named and name not in pages] == []
    assert len(told) == len(named)
    states = {run["id"]: run for run in asked(runs, "/api/runs")["runs"]}
    assert [states[name]["problem"] for name in SOUND] == ["", ""]
    assert all(asked(runs, "/api/run", id=name)["curves"] for name in SOUND)
    if file in (CONFIG, METRICS, CURVES):  # files that the server reads
        said = {name for name in must if f"left out: {runs / name / file}" in states[name]["problem"]}
        assert [damage_of[name] for name in must if must[name] and name not in said] == []


def asked(runs: Path, path: str, **query: str) -> Any:
    found = answer(runs, path, query)
    assert found is not None
    return json.loads(found[0])
