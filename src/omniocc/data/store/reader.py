"""Recorded scenes: the decoded arrays of any frame."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.protocol import is_finite
from omniocc.classes import FREE, UNKNOWN
from omniocc.data.formats.dataset_scene import Cloud, scan_of_points
from omniocc.data.source import LidarScan, Points
from omniocc.data.store.codec import (
    FACTS,
    LIDAR,
    PANORAMA,
    POINTS,
    decode_boxes,
    decode_image,
    decode_labels,
    decode_lidar,
    decode_points,
    decode_range,
)
from omniocc.data.store.files import LIMIT_BYTES, named
from omniocc.data.store.folder import Index, SceneFolder
from omniocc.data.store.shard import INDEX, META, digest, shard_name
from omniocc.errors import DataError
from omniocc.frame import Box
from rayiou.directions import sparseocc_directions
from rayiou.labels import ids_beyond

T = TypeVar("T")
FROM_LOG = "log"
"""Fact of scenes made of a real car's log, which has boxes of actors only where `BOXES` says so."""
BOXES = "boxes"
"""Fact of scenes made of a log: whether their frames have the boxes of all actors."""
LIDAR_POSITION = "lidar_position_m"
"""Fact of scenes made of a log with a LiDAR: its position in the ego frame, m."""
CONDITIONS = {"weather": "weather", "place": "theme"}
"""Facts by which the scenes of a test are told apart, by title."""
RIG_LIMIT_BYTES = 2**22
"""Largest size of a rig file, which is read in seconds."""
_RIGS: dict[tuple[str, ...], Rig] = {}
MOVES_MPS = 0.3
"""Speed from which an actor moves; a car at a red light does not."""
MARGIN_M = 0.3
"""Distance by which a hit may lie outside the upright box of an actor, since the road and the ego car tilt."""


@cache
def _lidar_directions() -> np.ndarray:
    return sparseocc_directions().float().numpy()


class SceneReader(SceneFolder):
    """A recorded scene (`omniocc.data.source.SceneFrames`); the LiDAR's rays are those of `sparseocc_directions`.

    Methods return None for parts that the scene lacks, which are those without members in its index.

    Args:
        folder: as in `SceneFolder`.
        masked: rig whose masks are used instead of the recorded ones; None keeps these.
        panorama: of the true ranges; None: as they were recorded.
    """

    _first_panorama: tuple[int, Equirectangular] | None = None  # the frame whose panorama was read first, and its size

    def __init__(self, folder: Path | str, masked: Rig | None = None, panorama: Equirectangular | None = None):
        super().__init__(folder)
        self.masked, self.panorama = masked, panorama

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"masked": self.masked, "panorama": self.panorama}

    @cached_property
    def fingerprint(self) -> str:
        """Return a hash that is equal for scenes with equal files, read in the same way."""
        sums = {name: facts["sha256"] for name, facts in self.meta["files"].items()}
        return digest([sums, None if self.masked is None else self.masked.fingerprint, repr(self.panorama)])

    @property
    def world_from_ego(self) -> np.ndarray:
        """Return the pose of every frame, (F, 4, 4) float64."""
        return self._timed.world_from_ego

    @property
    def time_s(self) -> np.ndarray:
        """Return the time of every frame since the scene began, (F,) float64."""
        return self._timed.time_s

    @property
    def _timed(self) -> Index:
        """Return the index; raise DataError if it has no times, as that of derived data."""
        if not len(self.index.time_s):
            raise self.damaged(INDEX, "it has no times and poses")
        return self.index

    @cached_property
    def rig(self) -> Rig:
        """Return the cameras that recorded the scene; scenes with equal files share one object.

        Raises:
            DataError: when other masks are to be used, and their rig has other cameras.
        """
        if self.masked is None:
            return self._recorded_rig
        if replace(self.masked, masks=None, road_z_m=None) != replace(self._recorded_rig, masks=None, road_z_m=None):
            raise DataError(
                f"{self.folder}: its cameras are not those of the rig with masks; make masks of the rig as it was "
                f"recorded: python src/mask.py rig={self.folder}/rig.yaml output=masked.yaml"
            )
        return replace(self._recorded_rig, masks=self.masked.masks)

    @cached_property
    def _recorded_rig(self) -> Rig:
        names = sorted({"rig.yaml", *(name for name in self.meta["files"] if name.startswith("rig."))})
        contents = [self.checked(name, RIG_LIMIT_BYTES if name == "rig.yaml" else LIMIT_BYTES) for name in names]
        key = tuple(self.meta["files"][name]["sha256"] for name in names)
        if key not in _RIGS:
            with TemporaryDirectory() as folder:
                for name, content in zip(names, contents, strict=True):
                    (Path(folder) / name).write_bytes(content)
                try:
                    _RIGS[key] = Rig.load(Path(folder) / "rig.yaml")
                except ValueError as error:
                    raise DataError(str(error).replace(folder, str(self.folder))) from error
        images = {name for name in self.index.members if name.startswith("rgb")}
        if images and images != {f"rgb{k}.jpg" for k in range(len(_RIGS[key].cameras))}:
            cameras = f"{len(_RIGS[key].cameras)} cameras"
            raise self.damaged("rig.yaml", f"it has {cameras}, the frames have {', '.join(sorted(images))}")
        return _RIGS[key]

    @property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame: the same ones."""
        return (self.rig,) * len(self)

    def images(self, frame: int) -> list[np.ndarray]:
        """Return the image of every camera, (H, W, 3) uint8 RGB each."""
        return self._of_cameras(frame, "rgb{}.jpg", lambda blob, _: decode_image(blob))

    def pixel_labels(self, frame: int) -> list[np.ndarray] | None:
        """Return the classes of the pixels of every camera, (H, W) uint8 each; 0 sky, 255 unknown."""
        if not self.has("semantic0.zst"):
            return None
        labels = self._of_cameras(frame, "semantic{}.zst", decode_labels)
        return [self._known(one, frame, "pixels") for one in labels]

    def camera_range_m(self, frame: int) -> list[np.ndarray] | None:
        """Return the true range of the pixels of every camera, (H, W) float32 each, m; inf sky, nan unknown."""
        if not self.has("range0.zst"):
            return None
        return self._of_cameras(frame, "range{}.zst", decode_range)

    def erp_range_m(self, frame: int) -> np.ndarray | None:
        """Return the true panorama of range around the ego origin, (h, w) float32, m; inf for sky, nan unknown."""
        if not self.has(PANORAMA):
            return None
        range_m = self._decoded(frame, PANORAMA, decode_range)
        recorded = self._recorded(frame, *range_m.shape)
        return range_m if self.panorama is None else resampled(range_m, recorded, self.panorama)

    def _recorded(self, frame: int, height: int, width: int) -> Equirectangular:
        """Return the recorded panorama; where its edges are not stated, they are the wanted ones.

        Raises:
            DataError: if it has another size than the first that was read of the scene, which states none.
        """
        wanted = (90.0, -90.0) if self.panorama is None else (self.panorama.top_deg, self.panorama.bottom_deg)
        with self._decoding(frame, PANORAMA):
            recorded = Equirectangular(width, height, *self.meta["facts"].get("panorama_edges_deg", wanted))
        self._first_panorama = first, other = self._first_panorama or (frame, recorded)
        if recorded != other:
            sizes = f"{width} x {height} px, that of frame {first} has {other.width} x {other.height} px"
            raise self._wrong(frame, f"it has {sizes}; all of a scene must be equal", PANORAMA)
        return recorded

    def lidar(self, frame: int) -> LidarScan | None:
        """Return the hits of the ego LiDAR."""
        if not self.has(LIDAR):
            return None
        blobs, directions = self.read(frame, [LIDAR, FACTS]), _lidar_directions()
        with self._decoding(frame, LIDAR):
            range_m, labels = decode_lidar(blobs[LIDAR], len(directions))
        if len(labels) != len(directions):
            raise self._wrong(frame, f"it has {len(labels):,} hits, its rays are {len(directions):,}", LIDAR)
        boxes = self._boxes(frame, blobs[FACTS])
        self._known(labels, frame, "LiDAR hits")
        known = FROM_LOG not in self.meta["facts"]
        moving = hits_of_moving(range_m, labels, directions, boxes) if known else None
        return LidarScan(range_m, labels, directions, moving=moving)

    def scan(self, frame: int) -> LidarScan | None:
        """Return `lidar`; of the log of a real car the rays to the points of its LiDAR.

        Raises:
            DataError: if the recording does not state where the LiDAR was.
        """
        points = self.points(frame) if FROM_LOG in self.meta["facts"] else None
        if points is None:
            return self.lidar(frame)
        position_m = self.meta["facts"].get(LIDAR_POSITION)
        if isinstance(position_m, list) and len(position_m) == len(self) and isinstance(position_m[frame], list):
            position_m = position_m[frame]  # older recordings state one for all
        if not isinstance(position_m, list) or len(position_m) != 3 or not all(map(is_finite, position_m)):
            raise self.damaged(META, "it does not state where the LiDAR was; remove the scene and record it again")
        scan = scan_of_points(Cloud(points.points_m, points.labels, np.array(position_m, np.float32)))
        if self.meta["facts"].get(BOXES) is not True:
            return scan
        boxes = self._boxes(frame, self.read(frame, [FACTS])[FACTS])
        return scan._replace(moving=hits_of_moving(scan.range_m, scan.labels, scan.directions, boxes, scan.origins))

    def _boxes(self, frame: int, blob: bytes) -> tuple[Box, ...]:
        """Return the boxes of a frame; raise DataError if they are damaged, or of a class that the scene lacks."""
        with self._decoding(frame, FACTS):
            boxes = decode_boxes(blob)
        self._known(np.array([box.label for box in boxes], np.uint8), frame, "boxes")
        return boxes

    @property
    def conditions(self) -> dict[str, str]:
        """Return weather and kind of place, as far as they were recorded."""
        facts = self.meta["facts"]
        return {title: str(facts[key]) for title, key in CONDITIONS.items() if key in facts}

    def points(self, frame: int) -> Points | None:
        """Return the labelled surface points."""
        if not self.has(POINTS):
            return None
        points_m, labels = self._decoded(frame, POINTS, decode_points)
        return Points(points_m, self._known(labels, frame, "points", FREE + 1))

    def has(self, member: str) -> bool:
        """Return whether the frames of the scene have a member of this name."""
        return member in self.index.members

    def _known(self, labels: np.ndarray, frame: int, kind: str, first: int = FREE) -> np.ndarray:
        """Return labels; raise DataError if some are none of the classes that were recorded with the scene."""
        num_classes = len(self.meta["facts"].get("spec", {}).get("classes", range(UNKNOWN)))
        if wrong := ids_beyond(labels, num_classes, first):
            has = f"the scene has {first} to {num_classes - 1}, and {UNKNOWN} for unknown"
            raise self._wrong(frame, f"{kind} of classes {wrong}; {has}")
        return labels

    def _wrong(self, frame: int, problem: str, member: str | None = None) -> DataError:
        """Return the error for content of a frame that does not fit the scene; it names shard, frame and member."""
        return self.damaged(shard_name(int(self.index.shard[frame])), problem, frame, member)

    def _decoded(self, frame: int, name: str, decode: Callable[[bytes], T]) -> T:
        blob = self.read(frame, [name])[name]
        with self._decoding(frame, name):
            return decode(blob)

    def _of_cameras(self, frame: int, pattern: str, decode: Callable[[bytes, int], np.ndarray]) -> list[np.ndarray]:
        """Return a member of every camera, decoded; raise DataError unless it has the size of the camera's image."""
        cameras = {pattern.format(k): camera for k, camera in enumerate(self.rig.cameras)}
        images = []
        for name, blob in self.read(frame, list(cameras)).items():
            height, width = cameras[name].height, cameras[name].width
            with self._decoding(frame, name):
                images.append(decode(blob, width * height))
            if (found := images[-1].shape[:2]) != (height, width):
                sizes = f"{found[1]} x {found[0]} px, but its camera has {width} x {height} px"
                raise self._wrong(frame, f"it has {sizes}", name)
        return images

    @contextmanager
    def _decoding(self, frame: int, name: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # decoders raise errors of many kinds
            raise self._wrong(frame, f"it cannot be decoded ({named(error)})", name) from error


def resampled(
    range_m: Float32[np.ndarray, "H W"], given: Equirectangular, wanted: Equirectangular
) -> Float32[np.ndarray, "h w"]:
    """Return a panorama of ranges with other rows and columns.

    A pixel has the range of the recorded pixel at its centre; if that is not known, the smallest known range of those
    in the pixel, so that the sparse points of a LiDAR are kept; nan without any, and beyond the recorded edges.
    """
    if given == wanted:
        return range_m
    rows, columns = _rows(wanted, given), _nearest(wanted.width, given.width)
    inside = (rows >= 0) & (rows < given.height)
    result = np.full((wanted.height, wanted.width), np.nan, np.float32)
    result[inside] = range_m[rows[inside]][:, columns]
    known = ~np.isnan(range_m)
    if known.all():
        return result
    row, column = np.nonzero(known)
    row, column = _rows(given, wanted)[row], _nearest(given.width, wanted.width)[column]
    held = (row >= 0) & (row < wanted.height)
    smallest = np.full_like(result, np.nan)
    np.fmin.at(smallest, (row[held], column[held]), range_m[known][held])
    return np.where(np.isnan(result), smallest, result)


def _nearest(count: int, other: int) -> np.ndarray:
    """Return the cell among `other` equal parts of the full turn that holds the centre of each of `count`."""
    return ((np.arange(count) + 0.5) * other / count).astype(np.int64)


def _rows(one: Equirectangular, other: Equirectangular) -> np.ndarray:
    """Return the row of another panorama that holds the centre of each row of one; outside of it beyond its edges."""
    elevation = one.top_deg - (np.arange(one.height) + 0.5) * (one.top_deg - one.bottom_deg) / one.height
    return np.floor((other.top_deg - elevation) * other.height / (other.top_deg - other.bottom_deg)).astype(np.int64)


def hits_of_moving(
    range_m: Float32[np.ndarray, " R"],
    labels: UInt8[np.ndarray, " R"],
    directions: Float32[np.ndarray, "R 3"],
    boxes: Sequence[Box],
    origins: Float32[np.ndarray, "R 3"] | None = None,
) -> Bool[np.ndarray, " R"]:
    """Return which rays hit an actor that moves: they end in its box, seen from above, on its class or an unknown one.

    Args:
        range_m: along the rays, m; inf where nothing is hit.
        labels: class that is hit.
        directions: unit rays in the ego frame.
        boxes: actors of the frame, moving or not, ego frame.
        origins: where the rays start, ego frame, m; None: in its origin.
    """
    found = np.zeros(len(labels), dtype=bool)
    for box in boxes:
        if np.hypot(*box.velocity_mps) < MOVES_MPS:
            continue
        rays = np.flatnonzero(((labels == box.label) | (labels == UNKNOWN)) & np.isfinite(range_m))
        ends_m = range_m[rays, None] * directions[rays, :2]
        away_m = (ends_m if origins is None else ends_m + origins[rays, :2]) - np.array(box.center_m[:2])
        cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        along_m = np.abs(away_m @ np.array([[cos, -sin], [sin, cos]]))
        found[rays[(along_m < np.array(box.size_m[:2]) / 2 + MARGIN_M).all(axis=1)]] = True
    return found
