"""Forge rig files and the calibrations of other tools: YAML, OCamCalib's text, masks, and the mesh of a car."""

import functools
import importlib.util
import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import yaml
from mutate import BROKEN, DAMAGED
from sandbox import Box, Case, Opening

KIND = "rigs and calibrations"
RIG = """\
road_z_m: -2.2
cameras:
  front:
    model: equidistant
    width: 64
    height: 36
    focal_px: 19.3
    center_px: [31.5, 17.5]
    max_angle_deg: 95.0
    ego_from_camera: {position_m: [0.9, 0, 0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}
    mask: front.png
  rear:
    model: equidistant
    width: 64
    height: 36
    focal_px: 19.3
    center_px: [31.5, 17.5]
    max_angle_deg: 95.0
    ego_from_camera: {position_m: [-0.9, 0, 0], yaw_deg: 180, pitch_deg: -10, roll_deg: 0}
"""
COMMANDS = 1
"""Commands beside that which masks, drawn at random: all of them read a rig by the same function."""
CAR = "v 9 9 -2\nv 9 10 -2\nv 10 9 -2\nv 9 9 -1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


@functools.cache
def texts() -> ModuleType:
    """Return the tests of calibrations, which hold files of other tools as texts."""
    path = Path(__file__).parents[1] / "camera" / "test_calibration.py"
    spec = importlib.util.spec_from_file_location("calibration_texts", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def sound() -> dict[str, tuple[str, str]]:
    """Return name and text of a sound file of every format."""
    found = texts()
    return {
        "rig": ("rig.yaml", RIG),
        "opencv": ("opencv.yaml", found.OPENCV),
        "ros": ("ros.yaml", found.ROS),
        "kalibr": ("chain.yaml", found.KALIBR),
        "ncore": ("ncore.json", found.NCORE),
        "driveworks": ("driveworks.json", found.DRIVEWORKS),
        "ocamcalib": ("calib_results.txt", found.OCAMCALIB),
        "kitti360": ("image_03.yaml", found.KITTI360),
        "omnimvs": ("config.yaml", found.OMNIMVS),
    }


def write(folder: Path, kind: str) -> Path:
    """Write a sound file, and the mask that it names; return its path."""
    name, text = sound()[kind]
    shape = {"rig": (36, 64), "omnimvs": (768, 800)}.get(kind)
    if shape is not None:
        mask = np.full(shape, 255 if kind == "rig" else 0, np.uint8)
        cv2.imwrite(str(folder / ("front.png" if kind == "rig" else "mask1.png")), mask)
    (folder / name).write_text(text)
    return folder / name


def openings(box: Box, path: Path, expect: str = "refused", check: Callable | None = None) -> list[Opening]:
    """Return the commands that read a rig; those that go on to read images or write programs only to refuse it."""
    base = box.base
    (box.given / "car.obj").write_text(CAR)
    checkpoint, images = f"checkpoint={base / 'run' / 'best.ckpt'}", f"images={base / 'frame'}"
    out = f"output={box.out / 'result'}"
    names = (path.name, "would be inside of", "cannot write")
    found = [Opening(("mask.py", f"rig={path}", f"car={box.given / 'car.obj'}", f"{out}.yaml"), expect, names, check)]
    if expect == "refused":
        data = ("data=recorded", f"data.source.root={base / 'scenes'}", f"data.source.cache={box.out / 'cache'}")
        splits = "data.source.splits={train:[test-000-*],val:[test-001-*],test:[test-002-*]}"
        log = ("recorder=files", "recorder.name=train-000-x", f"recorder.log={base / 'log'}", f"recorder.rig={path}")
        commands = [
            ("predict.py", "depth", f"rig={path}", images, out, "checkpoint=sweep", "preset=smoke"),
            ("predict.py", "occupancy", checkpoint, f"rig={path}", images, out),
            ("export.py", checkpoint, f"rig={path}", f"{out}.pt2"),
            ("record.py", *log, out),
            ("check.py", *data, splits, f"data.source.masks={path}", "preset=smoke", "--workers", "0", "--frames", "1"),
        ]
        drawn = random.Random(path.read_bytes() if path.is_file() and not path.is_symlink() else box.folder.name)
        found += [Opening(command, "refused", names) for command in drawn.sample(commands, COMMANDS)]
    return found


def saved(width: int | None = None, names: Sequence[str] | None = None, focal_px: float | None = None) -> Callable:
    """Return a check of the rig that the masking command has written: values of its first camera, or all names."""

    def check(out: Path, text: str) -> str | None:
        cameras = yaml.safe_load((out / "result.yaml").read_text())["cameras"]
        first = next(iter(cameras.values()))
        if names is not None and list(cameras) != list(names):
            return f"its cameras are {list(cameras)}, not {list(names)}"
        if width is not None and first["width"] != width:
            return f"its width is {first['width']}, not {width}"
        if focal_px is not None and first["focal_px"] not in (focal_px, [focal_px, focal_px]):
            return f"its focal length is {first['focal_px']}, not {focal_px}"
        return None

    return check


BOTH = ["front", "rear"]
LENS = RIG[RIG.index("    model") : RIG.index("    ego_from")]
THE_CAMERAS = RIG[RIG.index("cameras:") :]
LAUGHS = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
TEXTS: dict[str, tuple[str, str, str, str, Callable | None]] = {
    # name: kind, old text, new text, what has to come of it, check
    "twice-a-key": ("rig", "    width: 64\n", "    width: 64\n    width: 32\n", "refused", None),
    "twice-a-camera": ("rig", "  rear:\n", "  front:\n", "refused", None),
    "twice-the-cameras": ("rig", "road_z_m: -2.2\n", "cameras: {}\nroad_z_m: -2.2\n", "refused", None),
    "octal-width": ("rig", "width: 64", "width: 0100", "either", saved(width=64)),
    "sexagesimal-width": ("rig", "width: 64", "width: 1:04", "either", saved(width=64)),
    "width-with-underscore": ("rig", "width: 64", "width: 6_4", "either", saved(width=64)),
    "width-a-text": ("rig", "width: 64", "width: '64'", "either", saved(width=64)),
    "width-a-truth": ("rig", "width: 64", "width: yes", "refused", None),
    "width-a-fraction": ("rig", "width: 64", "width: 64.5", "refused", None),
    "width-nothing": ("rig", "width: 64", "width: 0", "refused", None),
    "width-below-nothing": ("rig", "width: 64", "width: -64", "refused", None),
    "width-of-gigabytes": ("rig", "width: 64", "width: 100000000", "refused", None),
    "width-of-400-digits": ("rig", "width: 64", "width: 1" + "0" * 400, "refused", None),
    "width-of-5000-digits": ("rig", "width: 64", "width: 1" + "0" * 5000, "refused", None),
    "focal-nan": ("rig", "focal_px: 19.3", "focal_px: .nan", "refused", None),
    "focal-infinite": ("rig", "focal_px: 19.3", "focal_px: .inf", "refused", None),
    "focal-overflows": ("rig", "focal_px: 19.3", "focal_px: 1.0e+400", "refused", None),
    "focal-nothing": ("rig", "focal_px: 19.3", "focal_px: 0", "refused", None),
    "focal-exponent-without-point": ("rig", "focal_px: 19.3", "focal_px: 2e1", "either", saved(focal_px=20.0)),
    "focal-decimal-comma": ("rig", "focal_px: 19.3", "focal_px: 19,3", "refused", None),
    "focal-a-list-of-lists": ("rig", "focal_px: 19.3", "focal_px: [[19.3]]", "refused", None),
    "center-one-number": ("rig", "center_px: [31.5, 17.5]", "center_px: [31.5]", "refused", None),
    "center-far-away": ("rig", "center_px: [31.5, 17.5]", "center_px: [1.0e+300, 1.0e+300]", "either", None),
    "angle-beyond-a-turn": ("rig", "max_angle_deg: 95.0", "max_angle_deg: 999", "refused", None),
    "angle-nothing": ("rig", "max_angle_deg: 95.0", "max_angle_deg: 0", "refused", None),
    "model-a-list": ("rig", "model: equidistant", "model: [equidistant]", "refused", None),
    "model-a-mapping": ("rig", "model: equidistant", "model: {a: 1}", "refused", None),
    "model-null": ("rig", "model: equidistant", "model:", "refused", None),
    "pose-nan": ("rig", "position_m: [0.9, 0, 0]", "position_m: [.nan, 0, 0]", "refused", None),
    "pose-a-text": ("rig", "position_m: [0.9, 0, 0]", "position_m: left", "refused", None),
    "yaw-a-truth": ("rig", "yaw_deg: 0,", "yaw_deg: no,", "refused", None),
    "yaw-infinite": ("rig", "yaw_deg: 0,", "yaw_deg: .inf,", "refused", None),
    "road-above": ("rig", "road_z_m: -2.2", "road_z_m: 2.2", "refused", None),
    "road-a-list": ("rig", "road_z_m: -2.2", "road_z_m: [-2.2]", "refused", None),
    "camera-named-on": ("rig", "  front:", "  on:", "either", saved(names=["on", "rear"])),
    "camera-named-null": ("rig", "  front:", "  null:", "either", saved(names=["null", "rear"])),
    "camera-named-number": ("rig", "  front:", "  007:", "either", saved(names=["007", "rear"])),
    "camera-named-date": ("rig", "  front:", "  2024-06-20:", "either", saved(names=["2024-06-20", "rear"])),
    "camera-named-empty": ("rig", "  front:", "  '':", "either", None),
    "camera-named-outward": ("rig", "  front:", "  x/../../../../neighbour/evil:", "either", None),
    "camera-named-absolute": ("rig", "  front:", "  /tmp/evil:", "either", None),
    "camera-named-nul": ("rig", "  front:", '  "a\\0b":', "refused", None),
    "camera-named-with-codes": ("rig", "  front:", '  "a\\e[2Jb":', "either", None),
    "camera-named-long": ("rig", "  front:", f"  ? {'a' * 400}\n  :", "either", None),
    "camera-a-list": ("rig", "  front:", "  ? [a, b]\n  :", "refused", None),
    "mask-outward": ("rig", "mask: front.png", "mask: ../neighbour/notes.txt", "refused", None),
    "mask-device": ("rig", "mask: front.png", "mask: /dev/zero", "refused", None),
    "mask-a-list": ("rig", "mask: front.png", "mask: [front.png]", "refused", None),
    "mask-nul": ("rig", "mask: front.png", 'mask: "a\\0b"', "refused", None),
    "calibration-itself": (
        "rig",
        LENS,
        "    calibration: rig.yaml\n",
        "refused",
        None,
    ),
    "calibration-device": (
        "rig",
        LENS,
        "    calibration: /dev/zero\n",
        "refused",
        None,
    ),
    "cameras-empty": ("rig", THE_CAMERAS, "cameras: {}\n", "refused", None),
    "cameras-a-text": ("rig", THE_CAMERAS, "cameras: front\n", "refused", None),
    "cameras-of-null": ("rig", THE_CAMERAS, "cameras: {front: , rear: }\n", "refused", None),
    "python-object": (
        "rig",
        "road_z_m: -2.2",
        "road_z_m: !!python/object/apply:os.system ['{touch}']",
        "refused",
        None,
    ),
    "python-name": ("rig", "road_z_m: -2.2", "road_z_m: !!python/name:os.system ''", "refused", None),
    "binary-tag": ("rig", "road_z_m: -2.2", "road_z_m: !!binary LTIuMg==", "refused", None),
    "set-tag": ("rig", "center_px: [31.5, 17.5]", "center_px: !!set {31.5, 17.5}", "refused", None),
    "alias-to-itself": ("rig", "center_px: [31.5, 17.5]", "center_px: &a [*a, *a]", "refused", None),
    "billion-laughs": ("rig", "road_z_m: -2.2\n", f"a0: &a0 [x, x]\n{LAUGHS}road_z_m: *a11\n", "refused", None),
    "deep-yaml": ("rig", "center_px: [31.5, 17.5]", f"center_px: {'[' * 5000}{']' * 5000}", "refused", None),
    "two-documents": ("rig", "  rear:\n", "---\n  rear:\n", "refused", None),
    "merge-key": (
        "rig",
        "    mask: front.png\n",
        "    mask: front.png\n    <<: {width: 32}\n",
        "either",
        saved(width=64),
    ),
    "byte-order-mark": ("rig", "road_z_m", "\ufeffroad_z_m", "either", saved(64, BOTH)),
    "carriage-returns": ("rig", "\n", "\r\n", "either", saved(64, BOTH)),
    "tabs": ("rig", "    width: 64", "\twidth: 64", "refused", None),
    "opencv-rows-below-nothing": ("opencv", "rows: 3", "rows: -3", "refused", None),
    "opencv-rows-huge": ("opencv", "rows: 3", "rows: 1000000000000", "refused", None),
    "opencv-data-a-text": ("opencv", "data: [ 960, 640 ]", "data: abc", "refused", None),
    "opencv-data-text-of-size": ("opencv", "data: [ 960, 640 ]", "data: '96'", "refused", None),
    "opencv-size-nothing": ("opencv", "data: [ 960, 640 ]", "data: [ 0, 640 ]", "refused", None),
    "opencv-size-overflows": ("opencv", "data: [ 960, 640 ]", "data: [ .inf, 640 ]", "refused", None),
    "opencv-coefficient-nan": ("opencv", "-4.3735601598704078e-02", ".nan", "refused", None),
    "opencv-twice-the-matrix": ("opencv", "dist_coeffs:", "camera_matrix:", "refused", None),
    "ros-skew": ("ros", "data: [300.0, 0,", "data: [300.0, 5,", "refused", None),
    "ros-width-nan": ("ros", "image_width: 640", "image_width: .nan", "refused", None),
    "kalibr-gap": ("kalibr", "cam1:", "cam7:", "refused", None),
    "kalibr-twice-a-camera": ("kalibr", "cam1:", "cam0:", "refused", None),
    "kalibr-resolution-nothing": ("kalibr", "resolution: [752, 480]", "resolution: [0, 0]", "refused", None),
    "kalibr-pose-stretched": ("kalibr", "[1.0, 0.0, 0.0, -0.11]", "[2.0, 0.0, 0.0, -0.11]", "refused", None),
    "kalibr-pose-infinite": ("kalibr", "[1.0, 0.0, 0.0, -0.11]", "[.inf, 0.0, 0.0, -0.11]", "refused", None),
    "kalibr-last-row": ("kalibr", "  - [0.0, 0.0, 0.0, 1.0]", "  - [0.0, 0.0, 0.0, 2.0]", "refused", None),
    "kalibr-intrinsics-few": ("kalibr", "[461.5, 460.2, 366.2, 249.0]", "[461.5, 460.2]", "refused", None),
    "kalibr-alpha-outside": ("kalibr", "0.56574", "7.5", "refused", None),
    "ocam-count-wrong": ("ocamcalib", "5 -1.966560e+02", "9 -1.966560e+02", "refused", None),
    "ocam-count-nan": ("ocamcalib", "5 -1.966560e+02", "nan -1.966560e+02", "refused", None),
    "ocam-polynomial-of-nothing": (
        "ocamcalib",
        "5 -1.966560e+02 0.000000e+00 3.053428e-03 -9.784996e-06 2.278718e-08",
        "1 0.0",
        "refused",
        None,
    ),
    "ocam-center-nan": ("ocamcalib", "383.000000 399.000000", "nan 399.0", "refused", None),
    "ocam-size-fraction": ("ocamcalib", "768 800", "768.7 800.2", "refused", None),
    "ocam-size-huge": ("ocamcalib", "768 800", "1e9 1e9", "refused", None),
    "ocam-size-nothing": ("ocamcalib", "768 800", "0 0", "refused", None),
    "ocam-affine-singular": ("ocamcalib", "1.000000 0.000000 0.000000", "0.0 0.0 0.0", "refused", None),
    "ocam-coefficients-many": ("ocamcalib", "768 800", "768 800 " + "1 " * 200_000, "refused", None),
    "ncore-size-nothing": ("ncore", "[960, 540]", "[0, 0]", "refused", None),
    "ncore-angle-nan": ("ncore", "1.3461724520632263", ".nan", "refused", None),
    "ncore-slope-nothing": ("ncore", "473.61334228515625", "0.0", "refused", None),
    "ncore-slope-huge": ("ncore", "473.61334228515625", "1e300", "either", None),
    "ncore-coefficients-many": ("ncore", "[0.0, 473.6", f"[{'0.0, ' * 50}473.6", "refused", None),
    "driveworks-sensors-of-text": ("driveworks", '"sensors": [', '"sensors": ["text", ', "refused", None),
    "driveworks-name-outward": ("driveworks", "camera:rear:70fov", "camera/../../x", "refused", None),
    "driveworks-twice-a-name": ("driveworks", "camera:rear:70fov", "camera:front:wide:120fov", "refused", None),
    "driveworks-pose-infinite": ("driveworks", "[-1.0, 0.2, 1.25]", "[-1.0, 0.2, .inf]", "refused", None),
    "driveworks-polynomial-nan": ("driveworks", "0 700 -3.5", "0 nan -3.5", "refused", None),
    "kitti360-size-nothing": ("kitti360", "image_width: 1400", "image_width: 0", "refused", None),
    "kitti360-mirror-a-list": ("kitti360", "   xi: 2.5535139132482758", "   - 2.55", "refused", None),
    "kitti360-mirror-huge": ("kitti360", "xi: 2.5535139132482758", "xi: 1e300", "refused", None),
    "kitti360-model-other": ("kitti360", "model_type: MEI", "model_type: [MEI]", "refused", None),
    "kitti360-name-outward": ("kitti360", "camera_name: image_03", "camera_name: ../../x", "either", None),
    "omnimvs-cameras-of-text": ("omnimvs", "  - cam_id: 1\n", "  - text\n  - cam_id: 1\n", "refused", None),
    "omnimvs-twice-an-id": ("omnimvs", "cam_id: 2", "cam_id: 1", "refused", None),
    "omnimvs-id-outward": ("omnimvs", "cam_id: 2", "cam_id: /../../../x", "either", None),
    "omnimvs-mask-device": ("omnimvs", 'invalid_mask: "mask1.png"', "invalid_mask: /dev/zero", "either", None),
    "omnimvs-pose-nan": ("omnimvs", "pose: [0.0, 0.0, 0.0,", "pose: [.nan, 0.0, 0.0,", "refused", None),
    "omnimvs-pose-huge": ("omnimvs", "pose: [0.0, 0.0, 0.0,", "pose: [1e300, 0.0, 0.0,", "refused", None),
    "omnimvs-angle-nan": ("omnimvs", "max_fov: 220.0\n", "max_fov: .nan\n", "refused", None),
}
"""Changes of sound texts. YAML reads 0100, yes, 1:04 and names such as on as something else than is written."""
MESHES = {
    "faces-beyond": CAR + "f 1 2 99\n",
    "faces-nothing": CAR + "f 0 1 2\n",
    "faces-far-below": CAR + "f -9 -8 -7\n",
    "vertices-nan": CAR.replace("v 9 9 -2", "v nan 9 -2"),
    "vertices-infinite": CAR.replace("v 9 9 -2", "v 1e400 9 -2"),
    "vertices-two-numbers": CAR.replace("v 9 9 -2", "v 9 9"),
    "faces-text": CAR + "f a b c\n",
    "empty": "",
    "faces-huge": CAR + "f 1 2 99999999999999999999999\n",
    "no-text": "\x00\x01" * 50,
}


def text_cases() -> Iterator[Case]:
    """Yield a case for every change of a text."""
    for name, (kind, old, new, expect, check) in TEXTS.items():

        def make(box: Box, name=name, kind=kind, old=old, new=new, expect=expect, check=check) -> list[Opening]:
            path = write(box.given, kind)
            text = path.read_text()
            assert old in text
            changed = text.replace(old, new.replace("{touch}", f"touch {box.marks / name}"), -1 if old == "\n" else 1)
            path.write_bytes(changed.encode())
            return openings(box, path, expect, check)

        yield Case(KIND, name, make)


def damaged_cases(rng: random.Random) -> Iterator[Case]:
    """Yield files and masks with other bytes, a format and three mutations for each kind."""
    for kind in sound():
        for name in (*rng.sample(sorted(BROKEN), 4), *rng.sample(sorted(DAMAGED), 2)):
            seed = rng.random()

            def make(box: Box, kind: str = kind, name: str = name, seed: float = seed) -> list[Opening]:
                path = write(box.given, kind)
                (BROKEN | DAMAGED)[name](path, random.Random(seed))
                return openings(box, path, "refused" if name in BROKEN else "either")

            yield Case(KIND, f"{kind}-{name}", make)
    for name in BROKEN:
        seed = rng.random()

        def make_mask(box: Box, name: str = name, seed: float = seed) -> list[Opening]:
            path = write(box.given, "rig")
            BROKEN[name](box.given / "front.png", random.Random(seed))
            return [Opening(one.command, one.expect, ("front.png",)) for one in openings(box, path)[:2]]

        yield Case(KIND, f"mask-{name}", make_mask)


def mesh_cases() -> Iterator[Case]:
    """Yield meshes of a car that are none."""
    for name, text in MESHES.items():

        def make(box: Box, name: str = name, text: str = text) -> list[Opening]:
            path = box.given / f"{name}.obj"
            path.write_text(text)
            out = f"output={box.out / 'result.yaml'}"
            return [Opening(("mask.py", f"rig={box.base / 'rig.yaml'}", f"car={path}", out), "refused", (path.name,))]

        yield Case(KIND, f"car-{name}", make)


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")

    def control(kind: str) -> Callable[[Box], Sequence[Opening]]:
        return lambda box: openings(box, write(box.given, kind), "right")

    found = [Case(KIND, f"sound-{kind}", control(kind)) for kind in sound()]
    return [*found, *text_cases(), *damaged_cases(rng), *mesh_cases()]
