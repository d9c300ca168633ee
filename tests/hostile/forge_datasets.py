"""Forge the files of public datasets: labels, calibrations, poses, tables, images, masks, points, of every source."""

import json
import random
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dataset_files import write_carlasc, write_woodscape
from forge_checkpoints import Reduced, touch
from kitti_files import write_kitti360, write_semantic_kitti, write_sscbench
from mutate import BROKEN, DAMAGED, linked_copy
from nuscenes_files import write_nuscenes
from rival_files import write_fisheye3dod, write_h3o, write_parkocc, write_quadocc
from sandbox import Box, Case, Opening

KIND = "dataset files"
FIRST = "sequences={train:['00'],val:['00'],test:['00']}"


def _parkocc(root: Path) -> None:
    """Write a scene of one frame, with a layer of road that cells of metres see."""
    write_parkocc(root, frames=(9,))
    cells = np.stack(np.meshgrid(*map(np.arange, (200, 200, 16)), indexing="ij"), -1).reshape(-1, 3)
    np.save(root / "sequences" / "8" / "9" / "occ_9.npy", np.c_[cells, np.full(len(cells), 3)].astype(np.int32))


SOURCES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "occ3d_nuscenes": (
        lambda root: write_nuscenes(root, frames=1, version="v1.0-mini"),
        ("version=v1.0-mini", "val_every=2"),
    ),
    "semantic_kitti": (lambda root: write_semantic_kitti(root, ("00",), frames=1), (FIRST,)),
    "sscbench_kitti360": (lambda root: write_sscbench(root, ("00",), frames=1), (FIRST,)),
    "kitti360": (
        lambda root: write_kitti360(root, ("00",), frames=3),
        (FIRST, "frame_step=2", "accumulate=1"),
    ),
    "carlasc": (lambda root: write_carlasc(root, frames=2), ()),
    "woodscape": (lambda root: write_woodscape(root, images=6), ("fractions={train:0.34,val:0.33,test:0.33}",)),
    "parkocc": (_parkocc, ()),
    "h3o": (lambda root: write_h3o(root, frames=1), ()),
    "quadocc": (lambda root: write_quadocc(root, frames=1), ("sequences={train:[a],val:[b],test:[c]}",)),
    "fisheye3dod": (
        lambda root: write_fisheye3dod(root, frames=2),
        ("towns={train:[Town01],val:[Town02],test:[Town03]}", "accumulate=1"),
    ),
}
"""Writer of a small sound dataset of each source, and further options, without `data.source.`."""
TOWN = "train-Town01_Opt-ClearNoon-2024_09_23_11_44_45/ego0"
DRIVE = "2013_05_28_drive_0000_sync"
CARLASC = "Cartesian/Train/Town01_Light/cartesian"
FILES = {
    "occ3d_nuscenes": (
        "gts/scene-0001/scene-0001-0/labels.npz",
        "samples/CAM_FRONT/scene-0001-0__CAM_FRONT__1532402926960000.jpg",
        "samples/LIDAR_TOP/scene-0001-0__LIDAR_TOP__1532402927000000.pcd.bin",
        "v1.0-mini/calibrated_sensor.json",
        "v1.0-mini/ego_pose.json",
        "v1.0-mini/sample.json",
        "v1.0-mini/sample_data.json",
        "v1.0-mini/scene.json",
        "v1.0-mini/sensor.json",
    ),
    "semantic_kitti": tuple(
        f"sequences/00/{name}"
        for name in (
            "calib.txt",
            "image_2/000000.png",
            "labels/000000.label",
            "poses.txt",
            "velodyne/000000.bin",
            "voxels/000000.bin",
            "voxels/000000.invalid",
            "voxels/000000.label",
            "voxels/000000.occluded",
        )
    ),
    "sscbench_kitti360": tuple(
        f"data_2d_raw/{DRIVE}/{name}"
        for name in (
            "image_00/data_rect/000000.png",
            "pose.txt",
            "voxels/000000.invalid",
            "voxels/000000.label",
        )
    ),
    "kitti360": (
        "calibration/calib_cam_to_pose.txt",
        "calibration/calib_cam_to_velo.txt",
        "calibration/image_02.yaml",
        "calibration/perspective.txt",
        f"data_2d_raw/{DRIVE}/image_02/data_rgb/0000000100.png",
        f"data_3d_raw/{DRIVE}/velodyne_points/data/0000000100.bin",
        f"data_poses/{DRIVE}/poses.txt",
    ),
    "carlasc": tuple(
        f"{CARLASC}/{name}"
        for name in (
            "evaluation/000000.bin",
            "evaluation/000000.label",
            "evaluation/params.json",
            "labels/000000.label",
            "poses.txt",
            "velodyne/000000.bin",
        )
    ),
    "woodscape": (
        "calibration/00000_FV.json",
        "rgb_images/00000_FV.png",
        "semantic_annotations/gtLabels/00000_FV.png",
    ),
    "parkocc": (
        "calib/front/calib_results_front.txt",
        "calib/front/results_front.csv",
        "sequences/8/9/front_9.jpg",
        "sequences/8/9/occ_9.npy",
        "sequences/dataset_sence_8.yaml",
        "velodyne/8/9/pc_9.bin",
    ),
    "h3o": (
        "sequences/Town01_a/occupancy_gt/000000.npy",
        "sequences/Town01_a/panorama_depth_m/000000.npy",
        "sequences/Town01_a/panorama_rgb/000000.png",
        "splits_homo.json",
    ),
    "quadocc": (
        "PAL_intrinsic_calib_results.txt",
        "sequences/a/images_unfold/000000.jpg",
        "sequences/a/lidar/000000.pcd",
        "sequences/a/voxel_final/000000.npy",
    ),
    "fisheye3dod": (
        "calib_results.txt",
        f"{TOWN}/fisheye_camera_front/00026981.png",
        f"{TOWN}/fisheye_camera_front/sensor_metadata.txt",
        f"{TOWN}/semantic_lidar/00026981.bin",
    ),
}
"""One file of every kind that a source reads."""
OPTIONAL = ("voxels/000000.occluded", "voxels/000000.bin", "PAL_intrinsic_calib_results.txt", "perspective.txt")
"""Files of which only some options make use."""
RAW = (".label", ".bin", ".invalid", ".occluded")
"""Suffixes of files that are numbers alone: zeros may be what was recorded, such as labels that are all unknown."""
PER_FILE = 2
"""Mutations of each file of a dataset that know nothing of its format."""
Tree = Any


def expected(path: Path, name: str) -> str:
    """Return what a command must do with a file after a mutation that knows nothing of its format."""
    shorter_scan = path.suffix == ".bin" and name in ("empty", "cut-in-half")
    zeros = path.suffix in RAW and name == "nul-bytes"
    return "refused" if name in BROKEN and not shorter_scan and not zeros else "either"


def sound(base: Path, source: str) -> Path:
    """Return the folder of a sound dataset."""
    return base / "datasets" / source


def write_all(folder: Path) -> None:
    """Write a small sound dataset of every source."""
    for source, (writer, _) in SOURCES.items():
        writer(folder / source)


def check_command(box: Box, source: str, root: Path) -> tuple[str, ...]:
    """Return the command that reads all frames of a dataset."""
    more = [f"data.source.{option}" for option in SOURCES[source][1]]
    cache = f"data.source.cache={box.out / 'cache'}"
    return ("check.py", f"data={source}", f"data.source.root={root}", *more, cache, "preset=smoke", "--workers", "0")


def _text(change: Callable[[str], str]) -> Callable[[Path, Box], None]:
    return lambda path, box: _write(path, change(path.read_text()).encode())


def _write(path: Path, content: bytes) -> None:
    path.unlink()
    path.write_bytes(content)


def _bytes(old: bytes, new: bytes) -> Callable[[Path, Box], None]:
    return lambda path, box: _write(path, path.read_bytes().replace(old, new))


def _first_number(new: str) -> Callable[[str], str]:
    """Return a change of the first number of every line that something stands before."""
    return lambda text: re.sub(
        r"(?<=[\s,:=(\[])-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?=[\s,)\]])(?P<rest>.*)", rf"{new}\g<rest>", text
    )


def _tree(change: Callable[[Tree], Any]) -> Callable[[Path, Box], None]:
    def make(path: Path, box: Box) -> None:
        tree = json.loads(path.read_text(encoding="utf-8"))
        found = change(tree)
        _write(path, json.dumps(tree if found is None else found).encode())

    return make


def _deepest(tree: Tree, value: Any) -> None:
    """Set the first value that is no list and no mapping."""
    inner = next(iter(tree)) if isinstance(tree, dict) else 0
    if isinstance(tree[inner], dict | list) and tree[inner]:
        _deepest(tree[inner], value)
    else:
        tree[inner] = value


def _without_key(tree: Tree) -> None:
    """Leave the last key of the first mapping out."""
    while isinstance(tree, list):
        tree = tree[0]
    tree.pop(list(tree)[-1])


def _array(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path, Box], None]:
    """Return a change of the arrays of an npy or npz file."""

    def make(path: Path, box: Box) -> None:
        found = np.load(path)
        if path.suffix == ".npz":
            arrays = {name: change(found[name]) for name in found.files}
            path.unlink()
            np.savez(path, allow_pickle=False, **arrays)
        else:
            changed = change(found)
            path.unlink()
            np.save(path, changed)

    return make


def _pickled(path: Path, box: Box) -> None:
    evil = np.array([Reduced(touch(box, "unpickled"))], dtype=object)
    names = np.load(path).files if path.suffix == ".npz" else []
    path.unlink()
    if names:
        np.savez(path, allow_pickle=True, **dict.fromkeys(names, evil))
    else:
        np.save(path, evil, allow_pickle=True)


def _numbers(dtype: str, value: float) -> Callable[[Path, Box], None]:
    """Return a change of all numbers of a file without header."""
    return lambda path, box: _write(path, np.full_like(np.fromfile(path, dtype), value).tobytes())


def _image(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path, Box], None]:
    def make(path: Path, box: Box) -> None:
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        path.unlink()
        cv2.imwrite(str(path), change(pixels))

    return make


def _png_of_gigabytes(path: Path, box: Box) -> None:
    """Write a PNG whose header says 2,000,000 by 2,000,000 px."""
    head = b"IHDR" + (2_000_000).to_bytes(4, "big") * 2 + b"\x08\x02\x00\x00\x00"
    chunk = (13).to_bytes(4, "big") + head + zlib.crc32(head).to_bytes(4, "big")
    _write(path, b"\x89PNG\r\n\x1a\n" + chunk + b"\x00\x00\x00\x00IEND\xaeB`\x82")


def _yaml_code(path: Path, box: Box) -> None:
    _write(path, f"9: !!python/object/apply:os.system ['{touch(box, 'yaml')}']\n".encode())


LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
SPECIFIC: dict[str, dict[str, tuple[str, Callable[[Path, Box], None]]]] = {
    ".txt": {
        "number-nan": ("refused", _text(_first_number("nan"))),
        "number-infinite": ("refused", _text(_first_number("inf"))),
        "number-overflows": ("refused", _text(_first_number("1e400"))),
        "number-a-word": ("refused", _text(_first_number("left"))),
        "number-with-underscore": ("refused", _text(_first_number("1_0"))),
        "number-of-5000-digits": ("either", _text(_first_number("1" * 5000))),
        "first-line-twice": ("either", _text(lambda text: text.splitlines()[0] + "\n" + text)),
        "carriage-returns": ("either", _text(lambda text: text.replace("\n", "\r\n"))),
        "byte-order-mark": ("either", _text(lambda text: "\ufeff" + text)),
        "decimal-commas": ("refused", _text(lambda text: text.replace(".", ","))),
        "utf-16": ("refused", lambda path, box: _write(path, path.read_text().encode("utf-16"))),
    },
    ".json": {
        "deep": ("refused", lambda path, box: _write(path, b"[" * 200_000)),
        "value-null": ("either", _tree(lambda tree: _deepest(tree, None))),
        "value-a-list": ("either", _tree(lambda tree: _deepest(tree, [[]]))),
        "value-outward": ("either", _tree(lambda tree: _deepest(tree, "../../../neighbour"))),
        "key-left-out": ("either", _tree(_without_key)),
        "a-number": ("refused", lambda path, box: _write(path, b"7")),
        "of-nulls": ("refused", lambda path, box: _write(path, b"[null, null]")),
        "number-of-5000-digits": ("refused", lambda path, box: _write(path, b"[" + b"1" * 5000 + b"]")),
        "nan": ("refused", lambda path, box: _write(path, b"NaN")),
        "empty-list": ("either", lambda path, box: _write(path, b"[]")),
    },
    ".yaml": {
        "python-object": ("refused", _yaml_code),
        "billion-laughs": ("refused", lambda path, box: _write(path, LAUGHS.encode())),
        "deep": ("refused", lambda path, box: _write(path, b"[" * 20_000)),
        "number-nan": ("refused", _text(_first_number(".nan"))),
        "a-list": ("refused", lambda path, box: _write(path, b"[1]")),
        "a-number": ("refused", lambda path, box: _write(path, b"7")),
        "twice": ("refused", _text(lambda text: text + "\n" + text.partition("---\n")[2])),
    },
    ".csv": {
        "number-nan": ("refused", _text(lambda text: "nan" + text[text.index(",") :])),
        "semicolons": ("refused", _text(lambda text: text.replace(",", ";"))),
        "cell-of-a-megabyte": ("refused", _text(lambda text: "1" * 2**20 + text)),
        "stretched": ("refused", _text(lambda text: "7.5" + text[text.index(",") :])),
    },
    ".npy": {
        "pickle": ("refused", _pickled),
        "flat": ("refused", _array(np.ravel)),
        "texts": ("refused", _array(lambda array: array.astype(str))),
        "complex": ("refused", _array(lambda array: array.astype(np.complex64))),
        "nan": ("refused", _array(lambda array: np.full(array.shape, np.nan))),
        "huge-numbers": ("refused", _array(lambda array: np.full(array.shape, 2**62))),
        "no-rows": ("either", _array(lambda array: array[:0])),
        "transposed": ("either", _array(np.transpose)),
        "big-endian": ("either", _array(lambda a: a.astype(">f8"))),
    },
    ".npz": {
        "pickle": ("refused", _pickled),
        "flat": ("refused", _array(np.ravel)),
        "texts": ("refused", _array(lambda array: array.astype(str))),
        "nan": ("refused", _array(lambda array: np.full(array.shape, np.nan))),
        "unknown-class": ("refused", _array(lambda array: np.full_like(array, 200))),
        "fractions": ("refused", _array(lambda array: array + 0.5)),
        "negative": ("refused", _array(lambda array: np.full(array.shape, -3))),
    },
    ".bin": {
        "nan": ("either", _numbers("<f4", np.nan)),
        "infinite": ("either", _numbers("<f4", np.inf)),
        "huge": ("either", _numbers("<f4", 1e30)),
    },
    ".label": {
        "unknown-class": ("refused", lambda path, box: _write(path, b"\xe7\x03" * (path.stat().st_size // 2))),
    },
    ".invalid": {"ones": ("either", lambda path, box: _write(path, b"\xff" * path.stat().st_size))},
    ".pcd": {
        "points-huge": ("refused", _bytes(b"POINTS ", b"POINTS 99999999")),
        "twice-x": ("refused", _bytes(b"x y z", b"x x z")),
    },
    ".png": {
        "of-gigabytes": ("refused", _png_of_gigabytes),
        "one-pixel": ("refused", _image(lambda image: image[:1, :1])),
        "cropped": ("refused", _image(lambda image: image[: len(image) // 2])),
        "sixteen-bits": ("either", _image(lambda image: image.astype(np.uint16) * 256)),
    },
    ".jpg": {
        "one-pixel": ("refused", _image(lambda image: image[:1, :1])),
        "cropped": ("refused", _image(lambda image: image[: len(image) // 2])),
        "grey": ("either", _image(lambda image: image[..., 0])),
    },
}
"""Mutations by the suffix of a file."""


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed: for every kind of file of every source some mutations."""
    rng = random.Random(f"{KIND} {seed}")
    found = []
    for source, files in FILES.items():

        def control(box: Box, source: str = source) -> list[Opening]:
            root = linked_copy(sound(box.base, source), box.given / source)
            return [Opening(check_command(box, source, root), "right", (source,))]

        found.append(Case(KIND, f"{source}-sound", control))
        for file in files:
            suffix = Path(file).suffix
            general = [*rng.sample(sorted(BROKEN), PER_FILE - 1), rng.choice(sorted(DAMAGED))]
            own = SPECIFIC.get(suffix, {})
            names = (*general, *rng.sample(sorted(own), min(PER_FILE, len(own))))
            found += [_case(source, file, name, rng.random()) for name in names]
    return [*found, *prediction_cases(rng)]


PREDICTIONS = {
    "occ3d_nuscenes": tuple(f"scene-000{number}-0.npz" for number in (1, 2, 3)),
    "semantic_kitti": ("sequences/00/predictions/000000.label",),
}
"""Files of predictions of the sources whose benchmark takes them."""


def _prediction(source: str, name: str, seed: float) -> Case:
    """Return the case of predictions of another project, whose first file is changed; `sound` changes none."""

    def make(box: Box) -> list[Opening]:
        folder = box.given / "predictions"
        for file in PREDICTIONS[source]:
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".npz":
                np.savez(path, pred=np.full((200, 200, 16), 11, np.uint8))
            else:
                np.full((256, 256, 32), 40, "<u2").tofile(path)
            expect, change = SPECIFIC[path.suffix].get(name, (expected(path, name), None))
            if change is not None:
                change(path, box)
            elif name != "sound":
                (BROKEN | DAMAGED)[name](path, random.Random(seed))
        _, *dataset = check_command(box, source, sound(box.base, source))
        command = ("evaluate.py", f"predictions={folder}", *dataset[:-2], "--output", str(box.out / "scores"))
        names = tuple(Path(file).name for file in PREDICTIONS[source])
        return [Opening(command, "right" if name == "sound" else expect, names)]

    return Case(KIND, f"predictions-of-{source}-{name}", make)


def prediction_cases(rng: random.Random) -> list[Case]:
    """Return the cases of predictions that are scored."""
    found = []
    for source, files in PREDICTIONS.items():
        own = sorted(SPECIFIC[Path(files[0]).suffix])
        names = ("sound", *own, *rng.sample(sorted(BROKEN), 4), *rng.sample(sorted(DAMAGED), 2))
        found += [_prediction(source, name, rng.random()) for name in names]
    return found


def _case(source: str, file: str, name: str, seed: float) -> Case:
    def make(box: Box) -> list[Opening]:
        root = linked_copy(sound(box.base, source), box.given / source)
        path = root / file
        own = SPECIFIC.get(path.suffix, {})
        if name in own:
            expect, change = own[name]
            change(path, box)
        else:
            expect = expected(path, name)
            (BROKEN | DAMAGED)[name](path, random.Random(seed))
        # the panorama has 8 rows at this preset, so that half of it has nearly the same aspect ratio
        if any(part in file for part in OPTIONAL) or ("images_unfold" in file and name == "cropped"):
            expect = "either"
        tables = [other.name for other in path.parent.glob("*.json")]  # which refer to one another
        return [
            Opening(check_command(box, source, root), expect, (path.name, *tables, "of the model's grid is occupied"))
        ]

    return Case(KIND, f"{source}-{file.replace('/', '.')}-{name}", make)
