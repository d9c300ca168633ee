"""A log becomes a scene: the samples that belong together are chosen, then written frame by frame."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from omniocc.camera import Camera, Equirectangular, Rig
from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.classes import OCCUPANCY_CLASSES
from omniocc.data.check_source import FAR_M, distances_m, out_of_reach
from omniocc.data.formats.files import check_aspect, scaled_to
from omniocc.data.formats.poses import transform_points
from omniocc.data.formats.projected import onto_cameras, onto_panorama
from omniocc.data.source import SPLITS, Points, SourceSpec
from omniocc.data.store.frame import RecordedFrame
from omniocc.data.store.meta import append_frame, finish_scene, panorama_of, recorded_spec
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders.log import Log, Plan, Timing, check_timing, missing_lines, plan_frames
from omniocc.io import checked_name
from omniocc.parallel import Report, make_scenes
from omniocc.progress import Progress

SHORTEST_S, LONGEST_S = 5e-4, 60.0
"""Limits of the median time between frames: beyond them the unit of the times is wrong."""
OFF_CENTRE_M = 0.5
"""Horizontal distance of the ego origin from the middle of the cameras from which it is said."""


class Stated(NamedTuple):
    """What no file of a log says.

    Attributes:
        image_size: width and height of the recorded images, px; None: that of the first camera's calibration.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        road_z_m: height of the road in the ego frame, m; None: that of the rig.
        moving: whether other things than the car move in the scene; None: not stated.
    """

    image_size: Sequence[int] | None
    panorama: Sequence[float]
    road_z_m: float | None
    moving: bool | None


class LogRecorder(ABC):
    """Base class of the recorders of logs, which are folders of files or ROS bags.

    Args:
        name: of the scene, and of its folder.
        timing: which samples make a frame.
        stated: what no file of the log says.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(self, name: str, timing: Timing, stated: Stated):
        self.name, self.timing, self.stated = check_name(name), check_timing(timing), stated
        panorama_of(stated.panorama)

    @abstractmethod
    def open(self) -> AbstractContextManager[Log]:
        """Return the log, to be used as a context; images and scans are read when they are asked for.

        Raises:
            UserError, DataError: naming the option, file or message that cannot be used.
        """

    def record(self, root: Path) -> list[Path]:
        """Write the scene into a folder of its name under `root` and return that folder, in a list.

        Raises:
            UserError, DataError: naming the option, file or message that cannot be used.
        """
        with self.open() as log:
            return [record_log(log, Path(root) / self.name, self.timing, self.stated)]


def record_log(log: Log, folder: Path, timing: Timing, stated: Stated) -> Path:
    """Write the scene of a log and return its folder; a scene made from the same log is returned as it is.

    Raises:
        UserError: naming the option that is impossible.
        DataError: naming the file that is damaged, or the folder that holds another scene.
    """
    plan = plan_frames(log, timing)
    rig = _scaled_rig(log.rig, stated)
    recipe = _recipe(log, plan, rig, timing, stated)
    if _is_made(folder, recipe):
        print(f"{folder} is there already, made from the same log with the same options")
        return folder
    with Progress(f"recording {folder}", len(plan.times_s)) as progress:
        lenses = lenses_that_do_not_fit(rig)
        told = name_lines(folder.name), plan_lines(plan, log.place), missing_lines(plan), lenses, origin_lines(rig)
        for line in itertools.chain(*told):
            progress.message(line)
        assert rig.road_z_m is not None
        reach_m = spec_of_log(log, plan, rig.road_z_m).reach_m
        check_points(log, plan, reach_m)
        whys: list[str] = []
        work = partial(_write, log=log, plan=plan, rig=rig, stated=stated, recipe=recipe, whys=whys)
        make_scenes(work, [folder], 0, progress)
        if whys:
            frames = f"{len(whys)} of {len(plan.times_s)} frames have hardly any points, in the first of them"
            progress.message(f"scene '{folder.name}': {frames} {whys[0]}")
    _is_made(folder, recipe)  # another process may have made one of this name meanwhile
    return folder


def _is_made(folder: Path, recipe: str) -> bool:
    """Return whether the scene exists; raise DataError if it was made from something else."""
    if not folder.exists():
        return False
    if SceneReader(folder).meta["facts"].get("recipe") != recipe:
        raise DataError(
            f"{folder}: there is a scene made from something else; choose another name, or remove it (log, calibration "
            "or options are not the same, or an older version recorded it)"
        )
    return True


def name_lines(name: str) -> list[str]:
    """Return a line about a name that `data=recorded` does not read by itself."""
    if name.startswith(tuple(f"{split}-" for split in SPLITS)):
        return []
    starts = ", ".join(f"{split}-" for split in SPLITS)
    return [
        f"data=recorded reads names that begin with one of {starts}; '{name}' has to be named in data.source.splits"
    ]


def origin_lines(rig: Rig) -> list[str]:
    """Return a line on an ego origin that is not between the cameras: depth is searched on spheres around it."""
    middle_m = rig.ego_from_camera[:, :2, 3].mean(0)
    if middle_m.norm() <= OFF_CENTRE_M:
        return []
    x_m, y_m = middle_m.tolist()
    return [
        f"the middle of the cameras is {x_m:.1f} m ahead of the ego origin and {y_m:.1f} m to its left; depth is "
        "searched on spheres around the origin, so put it there: by the poses of the rig, or ego_from_base of bags"
    ]


def plan_lines(plan: Plan, place: str) -> list[str]:
    """Return a line on the number of frames and their times.

    Raises:
        UserError: if the time between frames is that of no car's cameras.
    """
    count = len(plan.times_s)
    if count < 2:
        return ["1 frame"]
    step_s = float(np.median(np.diff(plan.times_s)))
    if not SHORTEST_S <= step_s <= LONGEST_S:
        raise UserError(
            f"{place}: the frames are {step_s:.3g} s apart, which no camera on a car is; is the unit of the times "
            "right (time_unit, poses_time_unit)?"
        )
    return [f"{count} frames, {plan.times_s[-1] - plan.times_s[0]:.1f} s, one each {step_s:.3g} s"]


def check_points(log: Log, plan: Plan, reach_m: float) -> None:
    """Check that some frame has points that can be used; mostly the first one has. A LiDAR may look far ahead alone.

    Raises:
        DataError: naming the likely reason, before anything is written.
    """
    if plan.scans is None or log.scans is None:
        return
    why = ""
    for number in range(len(plan.scans)):
        points = frame_points(log, plan, number)
        assert points is not None
        found, distance_m = out_of_reach(points.points_m, reach_m), distances_m(points.points_m)
        if not found or (len(distance_m) and np.median(distance_m) < FAR_M):
            return
        why = why or found
    if why:
        first = log.scans.name(int(plan.scans[0]))
        raise DataError(f"{first}: all {len(plan.scans)} frames have hardly any points, in the first of them {why}")


def _recipe(log: Log, plan: Plan, rig: Rig, timing: Timing, stated: Stated) -> str:
    """Return a hash of all that decides the frames but for the content of images and scans."""
    parts = [
        part.tobytes().hex()
        for part in (plan.times_s, plan.images, plan.world_from_ego, plan.scans, plan.ego_from_scan)
        if part is not None
    ]
    options = [list(timing), list(stated), rig.fingerprint, dict(log.facts), list(log.inputs)]
    return digest([*parts, repr(options), [] if log.scans is None else log.scans.classes.to_dict()])


def _scaled_rig(rig: Rig, stated: Stated) -> Rig:
    road_z_m = rig.road_z_m if stated.road_z_m is None else stated.road_z_m
    if road_z_m is None:
        raise UserError("the height of the road is not known: give road_z_m, m, in the ego frame, or in the rig file")
    first = rig.cameras[0]
    width, height = (first.width, first.height) if stated.image_size is None else map(int, stated.image_size)
    try:
        scaled = rig.resized(width, height)
    except ValueError as error:
        raise UserError(f"image_size: the cameras cannot be brought to {width}x{height} px: {error}") from error
    try:
        return replace(scaled, road_z_m=road_z_m)
    except ValueError as error:
        raise UserError(
            f"{error}; put the ego frame above it (ego_from_base of bags, or the poses of the rig)"
        ) from error


def spec_of_log(log: Log, plan: Plan, road_z_m: float) -> SourceSpec:
    """Return the classes of the points, the bands of the virtual world, and the median time between frames."""
    steps_s = np.diff(plan.times_s)
    interval_s = float(f"{np.median(steps_s):.2g}") if len(steps_s) else 0.0  # equal for scenes of one set of sensors
    classes = OCCUPANCY_CLASSES if log.scans is None else log.scans.classes
    return recorded_spec(classes, interval_s, road_z_m)


def _write(
    folder: Path, report: Report, log: Log, plan: Plan, rig: Rig, stated: Stated, recipe: str, whys: list[str]
) -> None:
    """Write all frames; add to `whys` why those with hardly any points have none within reach."""
    if folder.exists():  # another process has made it while this one waited
        report(len(plan.times_s))
        return
    assert rig.road_z_m is not None
    panorama = panorama_of(stated.panorama)
    with closing(SceneWriter(folder)) as writer:
        spec = spec_of_log(log, plan, rig.road_z_m)
        for number in range(len(plan.times_s)):
            frame = read_frame(log, plan, number, rig, panorama)
            if frame.points_m is not None and (why := out_of_reach(frame.points_m, spec.reach_m)):
                whys.append(why)
            append_frame(writer, frame)
            report(1)
        facts = {"log": dict(log.facts), "start_s": float(plan.times_s[0]), "moving": stated.moving}
        facts["missing"] = [{"time_s": time_s, "lacks": names} for time_s, names in plan.missing]
        edges_deg = panorama.top_deg, panorama.bottom_deg
        finish_scene(writer, rig, spec, edges_deg, facts | {"recipe": recipe})


def read_frame(log: Log, plan: Plan, number: int, rig: Rig, panorama: Equirectangular) -> RecordedFrame:
    """Return one frame of a log at the size of `rig`; with a LiDAR its points and what they show in every image.

    Raises:
        DataError: naming the image or scan that is damaged.
    """
    images = []
    for camera, (calibrated, scaled) in enumerate(zip(log.rig.cameras, rig.cameras, strict=True)):
        image, where = log.read_image(camera, int(plan.images[number, camera]))
        images.append(fitted(image, calibrated, (scaled.width, scaled.height), where))
    frame = RecordedFrame(float(plan.times_s[number] - plan.times_s[0]), plan.world_from_ego[number], np.stack(images))
    points = frame_points(log, plan, number)
    if points is None:
        return frame
    return replace(
        frame,
        range_m=np.stack([image.range_m for image in onto_cameras(points.points_m, None, rig)]),
        erp_range_m=onto_panorama(points.points_m, None, panorama).range_m,
        points_m=points.points_m,
        point_labels=points.labels,
    )


def frame_points(log: Log, plan: Plan, number: int) -> Points | None:
    """Return the points of a frame's scan in its ego frame; None without a LiDAR, DataError for a damaged scan."""
    if log.scans is None or plan.scans is None:
        return None
    points = log.scans.read(int(plan.scans[number]))
    if plan.ego_from_scan is None:
        return points
    # the car has moved since the scan, or had not yet
    return points._replace(points_m=transform_points(plan.ego_from_scan[number], points.points_m).astype(np.float32))


def fitted(
    image: UInt8[np.ndarray, "h w 3"], camera: Camera, size: tuple[int, int], where: str
) -> UInt8[np.ndarray, "height width 3"]:
    """Return an image scaled to `size` (width, height); raise DataError if it is not of the camera's aspect ratio."""
    check_aspect((image.shape[1], image.shape[0]), camera, where)
    return scaled_to(image, size)


def check_name(name: str) -> str:
    """Return the name of a scene; raise ValueError if it cannot be that of a folder of scenes, which has no point."""
    if "." in name:
        raise ValueError(f"name is '{name}'; a folder gets it: no point, no slash, such as train-000-town")
    return checked_name("name", name)
