"""Forge the files of finished and of unfinished runs, which reports, pages and the watching server read."""

import http.client
import json
import random
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mutate import BROKEN, DAMAGED, linked_copy
from sandbox import Box, Case, Opening, some

KIND = "folders of runs"
RUN = "ours-00000001"
METRICS, CONFIG, SCENES, CURVES = "metrics.json", "config.yaml", "scenes.json", "csv/version_0/metrics.csv"
SCRIPT = "<script>document.title='hostile'</script>"
COMMANDS = 2
Tree = dict[str, Any]
HEADER = "step,train/loss,val/rayiou\n"
SCENE = {"classes": ["free", "road"], "thresholds_m": [1.0], "scenes": {"a": {"conditions": {"weather": "clear"}}}}
"""A sound file of counts by scene, without counts."""


def openings(box: Box, names: tuple[str, ...], expect: str, seed: float) -> list[Opening]:
    """Return the report, and some of the other commands; a damaged run is named and left out."""
    runs, out = box.given / "runs", box.out
    found = [
        Opening(("report.py", "--runs", str(runs), "--output", str(out / "report")), expect, names, page_is_safe),
        Opening(("report.py", "--runs", str(runs), "--keep", str(out / "kept")), expect, names),
        watched(box),
    ]
    return some(found, COMMANDS, random.Random(seed))


def page_is_safe(out: Path, text: str) -> str | None:
    """Return what is wrong with the written pages: text of a run must not become a script of the page."""
    for path in (*out.rglob("*.html"), *out.rglob("*.md")):
        if SCRIPT in path.read_text():
            return f"{path.name} holds a script of the run"
    return None


def watched(box: Box) -> Opening:
    """Return the opening that serves the folder, asks for all that the page asks for, and stops."""
    port = random.randrange(20_000, 32_000)  # below those that the system gives to connections
    wrong: list[str] = []

    def asked() -> bool:
        """Ask for the list of runs and for each of them; return whether the server is up and has answered."""
        address = f"http://127.0.0.1:{port}"
        try:
            with urllib.request.urlopen(f"{address}/api/runs", timeout=20) as answer:
                states = json.load(answer)["runs"]
        except urllib.error.HTTPError as error:
            wrong.append(f"its list of runs is an error of the server: {error.code} {error.read()[:100]!r}")
            return True
        except (OSError, http.client.HTTPException):
            return False
        if not any(RUN not in json.dumps(state) for state in states):
            wrong.append("runs that are sound are not listed")
        for state in states:
            with suppress(urllib.error.HTTPError):
                urllib.request.urlopen(f"{address}/api/run?id={urllib.parse.quote(state['id'])}", timeout=20).close()
        return True

    return Opening(
        ("view.py", f"watch={box.given / 'runs'}", f"port={port}"), "either", ("watch=", "port="), None, asked, wrong
    )


def _json(change: Callable[[Tree], Any]) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        tree = json.loads(path.read_text(encoding="utf-8"))
        change(tree)
        _write(path, json.dumps(tree))

    return make


def _write(path: Path, content: str | bytes) -> None:
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def _text(content: str | bytes) -> Callable[[Path], None]:
    return lambda path: _write(path, content)


def _put(key: str, value: Any) -> Callable[[Path], None]:
    return _json(lambda tree: tree.update({key: value}))


def _figure(key: str, value: Any) -> Callable[[Path], None]:
    return _json(lambda tree: tree["metrics"].update({key: value}))


LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
CHANGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "metrics-deep": (METRICS, _text("[" * 200_000)),
    "metrics-a-list": (METRICS, _text("[]")),
    "metrics-nan": (METRICS, _text("NaN")),
    "metrics-long-number": (METRICS, _text('{"metrics": 1' + "0" * 5000 + "}")),
    "figures-a-list": (METRICS, _put("metrics", [1, 2])),
    "figures-of-text": (METRICS, _figure("test/rayiou", "high")),
    "figure-a-list": (METRICS, _figure("test/rayiou", [0.3])),
    "figure-nan": (METRICS, _figure("test/rayiou", float("nan"))),
    "figure-infinite": (METRICS, _figure("test/rayiou", float("inf"))),
    "figure-huge": (METRICS, _figure("test/rayiou", 1e300)),
    "figure-truth": (METRICS, _figure("test/rayiou", True)),
    "figure-null": (METRICS, _figure("test/rayiou", None)),
    "figure-of-400-digits": (METRICS, _figure("test/rayiou", 10**400)),
    "figure-named-script": (METRICS, _figure(f"test/rayiou/{SCRIPT}", 0.5)),
    "figure-named-outward": (METRICS, _figure("test/rayiou/../../../neighbour", 0.5)),
    "figure-named-long": (METRICS, _figure("test/rayiou/" + "a" * 10_000, 0.5)),
    "seed-a-list": (METRICS, _put("seed", [1])),
    "seed-a-script": (METRICS, _put("seed", SCRIPT)),
    "seed-a-mapping": (METRICS, _put("seed", {"a": 1})),
    "steps-text": (METRICS, _put("steps", "many")),
    "preset-outward": (METRICS, _put("preset", "../../../neighbour/x")),
    "preset-a-list": (METRICS, _put("preset", ["tiny"])),
    "preset-script": (METRICS, _put("preset", SCRIPT)),
    "preset-nul": (METRICS, _put("preset", "a\0b")),
    "preset-long": (METRICS, _put("preset", "a" * 5000)),
    "data-outward": (METRICS, _put("data", "/../../x")),
    "run-script": (METRICS, _put("run", SCRIPT)),
    "command-script": (METRICS, _put("command", SCRIPT)),
    "command-a-list": (METRICS, _put("command", [1])),
    "classes-texts": (METRICS, _put("classes", ["road"])),
    "classes-script": (METRICS, _put("classes", [{"name": SCRIPT, "rgb": [1, 2, 3]}])),
    "classes-colour": (METRICS, _put("classes", [{"name": "a", "rgb": "url(javascript:1)"}])),
    "classes-null": (METRICS, _put("classes", None)),
    "stages-a-list": (METRICS, _put("stages", [1])),
    "stages-texts": (METRICS, _put("stages", {"depth": "many"})),
    "protocol-a-text": (METRICS, _put("protocol", "rays")),
    "protocol-script": (METRICS, _put("protocol", {"rayiou": SCRIPT})),
    "minutes-text": (METRICS, _put("minutes of training", "a")),
    "finished-text": (METRICS, _put("finished", "<b>never</b>")),
    "candidates-text": (METRICS, _put("fraction of candidates", "a")),
    "config-python-object": (CONFIG, _text("a: !!python/object/apply:os.system ['touch {mark}']\n")),
    "config-laughs": (CONFIG, _text(LAUGHS)),
    "config-deep": (CONFIG, _text("[" * 20_000)),
    "config-a-list": (CONFIG, _text("[1]")),
    "config-a-number": (CONFIG, _text("7")),
    "config-not-utf8": (CONFIG, _text(b"a: \xff\xfe")),
    "config-model-text": (CONFIG, _text("model: evil\n")),
    "config-shape-text": (CONFIG, _text("model: {geometry: {shape: [a, b]}}\n")),
    "config-shape-huge": (CONFIG, _text(f"model: {{geometry: {{shape: [{10**300}, {10**300}]}}}}\n")),
    "config-target": (CONFIG, _text("model: {_target_: os.system, _args_: ['touch {mark}']}\n")),
    "config-interpolation": (CONFIG, _text("model: ${oc.env:HOSTILE_SECRET}\ndata: ${oc.env:HOSTILE_SECRET}\n")),
    "config-root-outward": (CONFIG, _text("data: {source: {root: ../../neighbour, _target_: os.system}}\n")),
    "config-itself": (CONFIG, _text("model: &a {b: *a}\n")),
    "config-dates": (CONFIG, _text("2024-01-01: 2024-01-01\n")),
    "scenes-a-list": (SCENES, _text("[]")),
    "scenes-deep": (SCENES, _text("[" * 200_000)),
    "scenes-classes-numbers": (SCENES, _text(json.dumps(SCENE | {"classes": [1, 2]}))),
    "scenes-counts-text": (SCENES, _text(json.dumps(SCENE | {"scenes": {"a": {"conditions": {}, "rays": "many"}}}))),
    "scenes-counts-few": (SCENES, _text(json.dumps(SCENE | {"scenes": {"a": {"conditions": {}, "rays": [[1]]}}}))),
    "scenes-counts-negative": (
        SCENES,
        _text(json.dumps(SCENE | {"scenes": {"a": {"conditions": {}, "rays": [[-1, 2]] * 3}}})),
    ),
    "scenes-counts-huge": (
        SCENES,
        _text(json.dumps(SCENE | {"scenes": {"a": {"conditions": {}, "rays": [[2**70, 2]] * 3}}})),
    ),
    "scenes-condition-script": (
        SCENES,
        _text(json.dumps(SCENE | {"scenes": {SCRIPT: {"conditions": {"weather": SCRIPT}}}})),
    ),
    "scenes-conditions-a-list": (SCENES, _text(json.dumps(SCENE | {"scenes": {"a": {"conditions": [1]}}}))),
    "curves-cell-of-a-megabyte": (CURVES, _text(HEADER + "9," + "1" * 2**20 + ",\n")),
    "curves-nul": (CURVES, _text(HEADER + "9,\0,\n")),
    "curves-text": (CURVES, _text(HEADER + "nine,low,\n")),
    "curves-nan": (CURVES, _text(HEADER + "nan,nan,nan\n")),
    "curves-infinite": (CURVES, _text(HEADER + "inf,inf,1e999\n")),
    "curves-few-cells": (CURVES, _text(HEADER + "9\n")),
    "curves-many-cells": (CURVES, _text(HEADER + "9,1,2,3,4\n")),
    "curves-no-header": (CURVES, _text("9,1,2\n")),
    "curves-steps-huge": (CURVES, _text(HEADER + f"{10**400},1,2\n")),
    "curves-script": (CURVES, _text(f"step,train/loss,val/{SCRIPT}\n9,1,2\n10,1,2\n")),
    "curves-not-utf8": (CURVES, _text(b"step,train/loss\n\xff\xfe,1\n")),
}
"""The file of a run that is changed, and the change."""
NAMES = {
    "script": SCRIPT.replace("/", "|"),
    "newline": "a\n# heading",
    "markdown": "a|b](javascript:1)`",
    "quote": "a\"'&<b>",
    "terminal": "a\x1b[2Jb",
    "long": "a" * 240,
    "dash": "--output",
    "equals": "a=b",
    "not-utf8": "a\udcffb",
    "template": "{{7*7}}",
    "percent": "%s%n%2e%2e",
    "dots": "...",
}
"""Names of folders of runs."""
IMAGE = "images/test-00-test-000-suburb-000001.png"


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = []

    def add(name: str, expect: str, names: tuple[str, ...], change: Callable[[Path, Box], Any]) -> None:
        drawn = rng.random()

        def make(box: Box) -> list[Opening]:
            runs = linked_copy(box.base / "runs", box.given / "runs")
            change(runs / RUN, box)
            return openings(box, names, expect, drawn)

        found.append(Case(KIND, name, make))

    add("sound", "right", (METRICS,), lambda run, box: None)
    for name, (file, change) in CHANGES.items():

        def changed(run: Path, box: Box, file: str = file, change: Callable[[Path], None] = change) -> None:
            change(run / file)
            content = (run / file).read_bytes()
            _write(run / file, content.replace(b"{mark}", str(box.marks / "config").encode()))

        add(name, "either", (Path(file).name,), changed)
    for name, folder in NAMES.items():
        add(
            f"named-{name}",
            "either",
            (METRICS, "runs"),
            lambda run, box, folder=folder: run.rename(run.parent / folder),
        )
    for file in (METRICS, CONFIG, CURVES, IMAGE, SCENES):
        for name in (*rng.sample(sorted(BROKEN), 3), rng.choice(sorted(DAMAGED))):
            drawn = rng.random()

            def damaged(run: Path, box: Box, file: str = file, name: str = name, drawn: float = drawn) -> None:
                if file == SCENES:
                    _write(run / file, json.dumps(SCENE))
                (BROKEN | DAMAGED)[name](run / file, random.Random(drawn))

            add(f"{Path(file).name}-{name}", "either", (Path(file).name,), damaged)
    return found
