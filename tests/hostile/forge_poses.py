"""Forge files of poses and of times, as predictions and logs take them."""

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mutate import BROKEN, DAMAGED, linked_copy
from sandbox import Box, Case, Opening

from omniocc.data.store.reader import SceneReader

KIND = "files of poses and times"
Change = Callable[[list[str]], list[str]]
POSE = "frame,1,2,3,1,0,0,0"


def _line(number: int, new: Callable[[str], str]) -> Change:
    return lambda lines: [new(line) if place == number else line for place, line in enumerate(lines)]


def _cell(number: int, column: int, value: str) -> Change:
    """Return a change of one cell of the file of poses."""

    def new(line: str) -> str:
        cells = line.split(",")
        cells[column] = value
        return ",".join(cells)

    return _line(number, new)


RIGHT: dict[str, Change] = {
    "sound": lambda lines: lines,
    "no-header": lambda lines: lines[1:],
    "byte-order-mark": _line(0, lambda line: f"\ufeff{line}"),
    "comments": lambda lines: ["# of a car", *lines, "# end"],
    "carriage-returns": lambda lines: [f"{line}\r" for line in lines],
    "blank-lines": lambda lines: [*lines, "", "  ", ""],
    "quoted": _line(1, lambda line: ",".join(f'"{cell}"' for cell in line.split(","))),
    "spaces": lambda lines: [line.replace(",", " , ") for line in lines],
    "other-order": lambda lines: [lines[0], *lines[:0:-1]],
    "frames-added": lambda lines: [*lines, f"9{lines[-1]}"],
}
"""Changes that leave the poses as they are."""
WRONG: dict[str, Change] = {
    "cell-nan": _cell(2, 4, "nan"),
    "cell-infinite": _cell(2, 4, "inf"),
    "cell-overflows": _cell(2, 4, "1e400"),
    "cell-empty": _cell(2, 4, ""),
    "cell-text": _cell(2, 4, "left"),
    "cell-hexadecimal": _cell(2, 4, "0x10"),
    "cell-with-underscore": _cell(2, 4, "1_0"),
    "cell-of-other-digits": _cell(2, 4, "١٢"),
    "cell-turns": _cell(2, 1, "7.5"),
    "cell-far": _cell(2, 4, "1e300"),
    "cell-decimal-comma": _cell(2, 4, "1,5"),
    "cell-of-a-megabyte": _cell(2, 4, "1" * 2**20),
    "cell-of-5000-digits": _cell(2, 4, "1" * 5000),
    "mirrored": _line(
        2,
        lambda line: ",".join(
            [line.split(",")[0], *["1", "0", "0", "0", "0", "1", "0", "0", "0", "0", "-1", "0", "0", "0", "0", "1"]]
        ),
    ),
    "last-row": _line(2, lambda line: line.rsplit(",", 1)[0] + ",2"),
    "frame-twice": lambda lines: [*lines, lines[2]],
    "frame-left-out": lambda lines: [line for place, line in enumerate(lines) if place != 2],
    "header-alone": lambda lines: lines[:1],
    "semicolons": lambda lines: [line.replace(",", ";") for line in lines],
    "quote-unclosed": _line(2, lambda line: f'"{line}'),
    "nul": _line(2, lambda line: f"{line[:20]}\0{line[20:]}"),
    "quaternion-of-nothing": _line(2, lambda line: line.split(",")[0] + ",1,2,3,0,0,0,0"),
    "quaternion-long": _line(2, lambda line: line.split(",")[0] + ",1,2,3,2,0,0,0"),
    "six-numbers": _line(2, lambda line: line.split(",")[0] + ",1,2,3,1,0,0"),
}
"""Changes that leave a pose without a meaning."""


def _occupancy(box: Box, path: Path) -> tuple[str, ...]:
    base = box.base
    return (
        "predict.py",
        "occupancy",
        f"checkpoint={base / 'run' / 'best.ckpt'}",
        f"images={base / 'sequence'}",
        f"rig={base / 'rig.yaml'}",
        f"poses={path}",
        f"output={box.out / 'result'}",
        "overview=false",
        "mesh=false",
    )


def record(box: Box, log: Path, *more: str) -> tuple[str, ...]:
    """Return the command that makes a scene of a log."""
    return (
        "record.py",
        "recorder=files",
        "recorder.name=test-000-log",
        f"recorder.log={log}",
        "recorder.road_z_m=-2.0",
        "recorder.panorama=[48,12,45.0,-45.0]",
        f"output={box.out / 'result'}",
        *more,
    )


def same_voxels(base: Path) -> Callable[[Path, str], str | None]:
    """Return a check that the prediction is that of the sound file."""

    def check(out: Path, text: str) -> str | None:
        for path in sorted((base / "answer").glob("*/voxels.npz")):
            ours = out / "result" / path.parent.name / "voxels.npz"
            if not np.array_equal(np.load(ours)["labels"], np.load(path)["labels"]):
                return f"frame {path.parent.name} is predicted with another pose"
        return None

    return check


def same_path(base: Path) -> Callable[[Path, str], str | None]:
    """Return a check that the recorded car drove as in the sound log."""

    def steps(scene: SceneReader) -> np.ndarray:
        poses = scene.world_from_ego
        return np.linalg.inv(poses[0]) @ poses

    def check(out: Path, text: str) -> str | None:
        ours, right = (steps(SceneReader(place / "test-000-log")) for place in (out / "result", base / "recorded"))
        if ours.shape != right.shape or not np.allclose(ours, right, atol=1e-9):
            return f"its poses differ from those of the sound log ({len(ours)} of {len(right)} frames)"
        return None

    return check


def times(path: Path, kind: str) -> str:
    """Return the poses of a log as `csv`, `tum` or `kitti` writes them: shifts along straight lines."""
    rows = []
    for place, line in enumerate(path.read_text(encoding="utf-8").splitlines()[1:]):
        stamp = line.split(",")[0]
        if kind == "tum":
            rows.append(f"{int(stamp) / 1e9:.9f} {place} 0 0 0 0 0 1")
        elif kind == "kitti":
            rows.append(f"1 0 0 {place} 0 1 0 0 0 0 1 0")
        else:
            rows.append(stamp)
    return "\n".join(rows) + "\n"


def expected(name: str) -> str:
    """Return what has to come of a change; other separators may be understood."""
    return "right" if name in RIGHT else "either" if name == "semicolons" else "refused"


def _of_prediction(name: str, change: Change) -> Case:
    def make(box: Box) -> list[Opening]:
        path = box.given / f"poses-{name}.csv"
        lines = (box.base / "sequence" / "poses.csv").read_text().splitlines()
        path.write_text("\n".join([*change(lines), ""]))
        return [Opening(_occupancy(box, path), expected(name), (path.name,), same_voxels(box.base))]

    return Case(KIND, f"{name}-of-frames", make)


def _of_log(name: str, change: Change) -> Case:
    def make(box: Box) -> list[Opening]:
        log = linked_copy(box.base / "log", box.given / "log")
        path = log / f"poses-{name}.csv"
        path.write_text("\n".join([*change((log / "poses.csv").read_text().splitlines()), ""]))
        command = record(box, log, f"recorder.poses={path.name}")
        return [Opening(command, expected(name), (path.name, log.name), same_path(box.base))]

    return Case(KIND, f"{name}-of-log", make)


TIMED: dict[str, tuple[str, str, Callable[[str], str]]] = {
    # name: format of the poses, the file that is changed, its change
    "tum-nan": ("tum", "poses", lambda text: text.replace(" 1 0 0 ", " nan 0 0 ", 1)),
    "tum-backwards": ("tum", "poses", lambda text: text.replace("17", "-17")),
    "tum-commas": ("tum", "poses", lambda text: text.replace(" ", ",")),
    "tum-time-huge": ("tum", "poses", lambda text: text.replace("17", "1e308", 1)),
    "tum-time-of-5000-digits": ("tum", "poses", lambda text: "1" * 5000 + text),
    "tum-time-with-underscores": ("tum", "poses", lambda text: text.replace("17", "1_7")),
    "kitti-times-few": ("kitti", "times", lambda text: text.split("\n", 1)[1]),
    "kitti-times-twice": ("kitti", "times", lambda text: (text.split("\n")[0] + "\n") * 3),
    "kitti-times-text": ("kitti", "times", lambda text: "a\n" * 3),
    "kitti-times-nan": ("kitti", "times", lambda text: "nan\n" * 3),
    "kitti-times-far": ("kitti", "times", lambda text: "1\n2\n3\n"),
    "kitti-turned": ("kitti", "poses", lambda text: text.replace("1 0 0 1", "0 0 0 1")),
}


def _timed(name: str, kind: str, which: str, change: Callable[[str], str]) -> Case:
    def make(box: Box) -> list[Opening]:
        log = linked_copy(box.base / "log", box.given / "log")
        files = {"poses": log / f"{name}-poses.txt", "times": log / f"{name}-times.txt"}
        for part, path in files.items():
            text = times(log / "poses.csv", kind if part == "poses" else "times")
            path.write_text(change(text) if part == which else text)
        more = [f"recorder.poses={files['poses'].name}", f"recorder.poses_format={kind}"]
        more += [f"recorder.poses_times={files['times'].name}", "recorder.poses_time_unit=ns"] * (kind == "kitti")
        expect = "either" if name == "tum-commas" else "refused"
        return [Opening(record(box, log, *more), expect, (files[which].name, "log: "))]

    return Case(KIND, name, make)


TABLES = {
    "table-text-as-time": "a,b\nc,d\n",
    "table-empty": "",
    "table-one-column": "1\n2\n",
    "table-nan": "nan,x.png\n",
    "table-of-a-megabyte": "1," + "x" * 2**20 + "\n",
    "table-nul": "1,a\0b\n",
    "table-not-listed": "1,front/1.png\n",
    "table-outward": "1,../../neighbour/notes.txt\n",
}


def _table(name: str, text: str) -> Case:
    def make(box: Box) -> list[Opening]:
        log = linked_copy(box.base / "log", box.given / "log")
        (log / f"{name}.csv").write_text(text)
        return [Opening(record(box, log, f"recorder.times={name}.csv"), "refused", (f"{name}.csv", "CSV of times"))]

    return Case(KIND, name, make)


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = [_of_prediction(name, change) for name, change in (RIGHT | WRONG).items()]
    found += [_of_log(name, change) for name, change in (RIGHT | WRONG).items() if name != "frame-left-out"]
    found += [_timed(name, *what) for name, what in TIMED.items()] + [_table(*item) for item in TABLES.items()]
    for name in (*BROKEN, *DAMAGED):
        seed_of_file = rng.random()

        def make(box: Box, name: str = name, seed: float = seed_of_file) -> list[Opening]:
            path = box.given / f"poses-{name}.csv"
            path.write_bytes((box.base / "sequence" / "poses.csv").read_bytes())
            (BROKEN | DAMAGED)[name](path, random.Random(seed))
            expect = "refused" if name in BROKEN else "either"
            return [Opening(_occupancy(box, path), expect, (path.name,))]

        found.append(Case(KIND, name, make))
    return found
