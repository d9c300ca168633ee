"""Logs that the library py123d (extra `py123d`) has converted: nuScenes, nuPlan, KITTI-360, Waymo and others."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from omniocc.errors import UserError
from omniocc.extras.recorders.log import Log, Timing
from omniocc.extras.recorders.log_scene import LogRecorder, SceneOptions

INSTALL = "the library py123d is missing: docs/datasets/py123d.md installs the extra `py123d` (Python 3.11 to 3.13)"
SYNC = "sync.arrow"
"""File that every log of the library has."""


class Py123dLog(LogRecorder):
    """A recorder of a log of py123d; options are described in `conf/recorder/py123d.yaml`.

    Args:
        name: of the scene, and of its folder.
        log: folder of the log, which holds `sync.arrow`.
        cameras: names that the library gives to the cameras (`pcam_f0`); None: all.
        lidar: name that the library gives to the LiDAR; `any`: all in one, or the only one; None: without points.
        classes: whether points have the library's classes; where it has none all are occupied.
        boxes: whether the boxes of actors are recorded, where the log has them.
        reference: see `Timing`, as `limit_s`, `interval_s` and `pose_gap_s`.
        image_size: see `SceneOptions`, as `panorama`, `road_z_m` and `moving`; the log states a height of the road.
        origin_above_road_m: see `LogRecorder`.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(
        self,
        name: str,
        log: str,
        cameras: Sequence[str] | None,
        lidar: str | None,
        classes: bool,
        boxes: bool,
        reference: str | None,
        limit_s: float,
        interval_s: float | None,
        pose_gap_s: float,
        image_size: tuple[int, int] | None,
        panorama: tuple[int, int, float, float],
        road_z_m: float | None,
        moving: bool | None,
        origin_above_road_m: float | None,
    ):
        super().__init__(
            name,
            Timing(reference, limit_s, interval_s, pose_gap_s),
            SceneOptions(image_size, panorama, road_z_m, moving),
            origin_above_road_m,
        )
        self.folder, self.cameras, self.lidar = Path(log), cameras, lidar
        self.classes, self.boxes = classes, boxes

    @contextmanager
    def open(self) -> Iterator[Log]:
        """Give the log; images and scans are read when they are asked for.

        Raises:
            UserError: if the library or the log is missing, or an option names what the log does not have.
            DataError: naming the file that cannot be used.
        """
        try:
            from omniocc.extras.recorders.py123d_reader import Py123dReader
        except ImportError as error:
            raise UserError(INSTALL) from error
        if not (self.folder / SYNC).is_file():
            raise UserError(f"log={self.folder}: there is no {SYNC}; give the folder of one log of py123d")
        reader = Py123dReader(self.folder, self.cameras)
        facts = {"recorder": "py123d", **reader.facts, "limit_s": self.timing.limit_s}
        inputs = [str(self.folder.absolute()), reader.files, self.lidar, self.classes, self.boxes]
        scans = None if self.lidar is None else reader.scans(self.lidar, self.classes, self.boxes, self.timing.limit_s)
        yield Log(str(self.folder), *reader.views(), *reader.poses(), scans, facts, inputs)
