"""WoodScape as a source: real fisheye images with the classes of their pixels, one camera at a time."""

import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from omniocc.camera import Equirectangular, RadialPolynomial, Rig
from omniocc.classes import UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.dataset_scene import DatasetScene
from omniocc.data.formats.files import (
    check_root,
    check_size,
    class_table,
    decode,
    map_classes,
    read_image,
    read_text,
    scaled_size,
)
from omniocc.data.formats.poses import quaternion_pose, shift
from omniocc.data.labels.own_grid import OwnGridLabels
from omniocc.data.source import SPLITS, Ignore, SourceSpec, Split
from omniocc.data.store.shard import digest
from omniocc.errors import FAULTS, DataError
from omniocc.geometry import Grid
from omniocc.io import number_of, parse_json

VIEWS = ("FV", "RV", "MVL", "MVR")
ORIGIN_M = (1.6, 0.0, 1.2)
"""Our ego origin in the vehicle frame of WoodScape, whose origin is on the ground below the rear axle."""
LENS_DEG = 95.0
NAMES = (
    ("sky", (225, 233, 242)),
    ("road", (128, 64, 128)),
    ("lanemarks", (157, 234, 50)),
    ("curb", (244, 35, 232)),
    ("person", (220, 20, 60)),
    ("rider", (255, 0, 0)),
    ("vehicles", (0, 0, 142)),
    ("bicycle", (119, 11, 32)),
    ("motorcycle", (0, 0, 230)),
    ("traffic_sign", (220, 220, 0)),
)
CLASSES = ClassTable(tuple(SemanticClass(number, name, rgb) for number, (name, rgb) in enumerate(NAMES)))
"""Classes of pixels. In the files 0 is void, whatever is none of the others: here unknown, and no pixel is 'sky'."""
TABLE = class_table({0: UNKNOWN} | {number: number for number in range(1, len(NAMES))})


class WoodScape:
    """A source (`SceneSource`) of WoodScape for the 2D head: images and classes of pixels; no ranges, no voxels.

    The views of a number are not of one moment, so every image is a scene of one frame with one camera.

    Args:
        root: folder with `rgb_images`, `calibration` and `semantic_annotations/gtLabels`.
        fractions: of the images of train, val and test, in the order of their numbers.
        image_width: of the images that the model gets, px; the height follows, a multiple of 8.
        cache: folder for class statistics; None: `omniocc` in root.

    Raises:
        ValueError: if the width or the fractions are impossible.
    """

    def __init__(self, root: str, fractions: Mapping[Split, float], image_width: int, cache: str | None):
        if image_width < 8:
            raise ValueError(f"image_width must be at least 8, got {image_width}")
        if set(fractions) != set(SPLITS) or min(fractions.values()) < 0 or sum(fractions.values()) > 1 + 1e-9:
            raise ValueError(f"fractions need {', '.join(SPLITS)} and add up to at most 1, got {dict(fractions)}")
        self.root, self.fractions, self.image_width = root, fractions, image_width
        self.folder = Path(root, "omniocc") if cache is None else Path(cache)

    @property
    def spec(self) -> SourceSpec:
        """Return the classes of pixels; the bands have no use, since there are no ranges."""
        return SourceSpec(CLASSES, (0.0, 25.6), 1.0, -ORIGIN_M[2], None)

    @property
    def fingerprint(self) -> str:
        """Return a hash of the names of the images, of the fractions and of the size."""
        return digest([self.names, dict(self.fractions), self.image_width])

    @cached_property
    def names(self) -> list[str]:
        """Return the names of all images that have annotations, in order: '00000_FV'."""
        pattern = re.compile(rf"\d{{5}}_({'|'.join(VIEWS)})\.png")
        folder = Path(self.root, "semantic_annotations", "gtLabels")
        return sorted(path.stem for path in folder.iterdir() if pattern.fullmatch(path.name))

    def prepare(self) -> None:
        """Check the folders.

        Raises:
            DataError: naming what is missing.
        """
        check_root(self.root, ["rgb_images", "calibration", "semantic_annotations"], "unpack WoodScape into it")
        check_root(str(Path(self.root, "semantic_annotations")), ["gtLabels"], "unpack WoodScape's annotations")
        if not self.names:
            raise DataError(f"{self.root}/semantic_annotations/gtLabels: there are no files such as 00000_FV.png")

    def scenes(self, split: Split) -> Sequence["WoodScapeImage"]:
        """Return the images of a split."""
        before = sum(self.fractions[other] for other in SPLITS[: SPLITS.index(split)])
        first, last = (round(part * len(self.names)) for part in (before, before + self.fractions[split]))
        return [WoodScapeImage(name, self) for name in self.names[first:last]]

    def labels(self, geometry: Grid, ignore: Ignore) -> OwnGridLabels:
        """Return labels that are always None: there are no voxels."""
        return OwnGridLabels(self.folder, self.fingerprint, geometry, geometry, CLASSES.num_classes, ignore)


class WoodScapeImage(DatasetScene):
    """One image as a scene of one frame."""

    dataset = "WoodScape"

    def __init__(self, name: str, source: WoodScape):
        super().__init__(name, Equirectangular(8, 4, 45.0, -45.0))
        self.root, self.image_width = Path(source.root), source.image_width
        self.world_from_ego = np.eye(4)[None]

    def __len__(self) -> int:
        return 1

    @cached_property
    def rigs(self) -> tuple[Rig]:
        """Return the one camera."""
        with self.naming(0):
            camera, vehicle_from_camera = read_calibration(self.root / "calibration" / f"{self.name}.json")
        scaled = camera.resized(*scaled_size(camera.width, camera.height, self.image_width))
        pose = shift(*(-value for value in ORIGIN_M)) @ vehicle_from_camera
        view = self.name.split("_")[1]
        return (Rig((scaled,), torch.from_numpy(pose)[None], (view,), None, -ORIGIN_M[2]),)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the image, scaled."""
        camera = self.rigs[frame].cameras[0]
        with self.naming(frame):
            return [read_image(self.root / "rgb_images" / f"{self.name}.png", None, (camera.width, camera.height))]

    def pixel_labels(self, frame: int) -> list[np.ndarray]:
        """Return the classes of the pixels, scaled without mixing them."""
        camera = self.rigs[frame].cameras[0]
        path = self.root / "semantic_annotations" / "gtLabels" / f"{self.name}.png"
        with self.naming(frame):
            ids = decode(path, cv2.IMREAD_UNCHANGED)
            if ids.ndim != 2:
                raise DataError(f"{path}: the file is no image of class ids")
            check_size(path, ids.shape[::-1], None, (camera.width, camera.height))
            classes = map_classes(ids.astype(np.int64), TABLE, path)
        return [cv2.resize(classes, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST_EXACT)]

    def own_voxels(self, frame: int, ignore: Ignore) -> None:
        """Return None: there are no voxels."""

    def benchmark(self, frame: int) -> None:
        """Return None: there are no voxels."""


def read_calibration(path: Path) -> tuple[RadialPolynomial, np.ndarray]:
    """Return the lens of a calibration file, and `vehicle_from_camera` (4, 4).

    Raises:
        DataError: naming the key that is missing or wrong.
    """
    content = read_text(path)
    try:
        plain: dict[str, Any] = parse_json(content)
        lens, place = plain["intrinsic"], plain["extrinsic"]
        if "translation" not in place:
            raise ValueError("extrinsic has no translation; SynWoodScape's left-handed calibrations are not supported")
        width, height = (int(number_of(str(lens[side]))) for side in ("width", "height"))
        # the offsets are from the middle of the image, which is at (width - 1) / 2 where pixel centres are integers
        center = (lens["cx_offset"] + width / 2 - 0.5, lens["cy_offset"] + height / 2 - 0.5)
        radii = tuple(number_of(str(lens[f"k{k}"])) for k in range(1, 5))
        camera = RadialPolynomial(width, height, radii, center, number_of(str(lens["aspect_ratio"])), LENS_DEG)
        x, y, z, w = place["quaternion"]
        return camera, quaternion_pose((w, x, y, z), place["translation"], "extrinsic")
    except FAULTS as error:
        reason = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{path}: {reason}") from error
