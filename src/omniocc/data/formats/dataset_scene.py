"""What the scenes of public datasets have in common: what they lack, and what follows from a LiDAR's points."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import ClassVar, NamedTuple

import cv2
import numpy as np

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import UNKNOWN
from omniocc.data.formats.projected import Projected, onto_cameras, onto_panorama
from omniocc.data.source import LidarScan, Points
from omniocc.errors import FAULTS, DataError, reason_of


class Cloud(NamedTuple):
    """The points of a LiDAR in one frame.

    Attributes:
        points_m: (P, 3) float32, m, ego frame.
        labels: (P,) uint8 class of each, 255 unknown; None: the dataset has no classes of points.
        origin_m: (3,) where the rays start, m, ego frame.
    """

    points_m: np.ndarray
    labels: np.ndarray | None
    origin_m: np.ndarray


class DatasetScene:
    """A scene of which everything is absent but its name; fulfils `SceneFrames` with what a dataset adds.

    Ranges, classes of pixels and LiDAR rays follow from `cloud`, if there is one: they are sparse, unknown (nan, 255)
    where no point falls.

    Args:
        name: of the scene.
        panorama: of `erp_range_m`, around the ego origin.
    """

    dataset: ClassVar[str]
    """Name of the dataset in messages."""

    def __init__(self, name: str, panorama: Equirectangular):
        self.name, self.panorama = name, panorama

    @property
    @abstractmethod
    def rigs(self) -> Sequence[Rig]:
        """See `SceneFrames`."""

    @contextmanager
    def naming(self, frame: int) -> Iterator[None]:
        """Let errors of reading and impossible values name dataset, scene and frame."""
        try:
            yield
        except (DataError, cv2.error, *FAULTS) as error:
            where = f"{self.dataset}, scene '{self.name}', frame {frame}"
            raise DataError(f"{where}: {reason_of(error)}") from error

    def cloud(self, frame: int) -> Cloud | None:
        """Return the points of the LiDAR; None without one."""
        del frame
        return None

    def pixel_labels(self, frame: int) -> list[np.ndarray] | None:
        """Return the classes of the points that the cameras see, 255 elsewhere; None without such classes."""
        cloud = self.cloud(frame)
        if cloud is None or cloud.labels is None:
            return None
        return [image.labels for image in onto_cameras(cloud.points_m, cloud.labels, self.rigs[frame])]

    def camera_range_m(self, frame: int) -> list[np.ndarray] | None:
        """Return the ranges of the points that the cameras see, nan elsewhere."""
        cloud = self.cloud(frame)
        return cloud and [image.range_m for image in onto_cameras(cloud.points_m, None, self.rigs[frame])]

    def erp_range_m(self, frame: int) -> np.ndarray | None:
        """Return the ranges of the points around the ego origin as a panorama, nan elsewhere."""
        found = self._around(frame)
        return found and found.range_m

    def lidar(self, frame: int) -> LidarScan | None:
        """Return the ray of the LiDAR to each of its points, also of unknown class; None without classes."""
        cloud = self.cloud(frame)
        return None if cloud is None or cloud.labels is None else scan_of_points(cloud)

    def scan(self, frame: int) -> LidarScan | None:
        """Return the ray of the LiDAR to each of its points, all of unknown class if they have none."""
        cloud = self.cloud(frame)
        return None if cloud is None else scan_of_points(cloud)

    def points(self, frame: int) -> Points | None:
        """Return the points that vote for voxels: None, since the labels come with the dataset."""
        del frame
        return None

    def _around(self, frame: int) -> Projected | None:
        cloud = self.cloud(frame)
        return cloud and onto_panorama(cloud.points_m, None, self.panorama)


def scan_of_points(cloud: Cloud) -> LidarScan:
    """Return the ray of a LiDAR to each of its points, of unknown class if they have none."""
    labels = np.full(len(cloud.points_m), UNKNOWN, np.uint8) if cloud.labels is None else cloud.labels
    ways = cloud.points_m - cloud.origin_m
    range_m = np.linalg.norm(ways, axis=1).astype(np.float32)
    origins = np.broadcast_to(cloud.origin_m, ways.shape).astype(np.float32)
    return LidarScan(range_m, labels, (ways / range_m[:, None]).astype(np.float32), origins)


def outside(points_m: np.ndarray, low_m: Sequence[float], high_m: Sequence[float]) -> np.ndarray:
    """Return which points (P, 3) are outside of a box, such as that of the own car."""
    return np.any((points_m < np.asarray(low_m)) | (points_m > np.asarray(high_m)), axis=1)
