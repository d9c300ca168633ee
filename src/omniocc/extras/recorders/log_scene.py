"""Record a log as a scene: choose the images and the scan of every frame, then write frame by frame."""

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
from omniocc.data.formats.dataset_scene import Cloud
from omniocc.data.formats.files import check_aspect, scaled_to
from omniocc.data.formats.poses import transform_points
from omniocc.data.formats.projected import onto_cameras, onto_panorama
from omniocc.data.source import SPLITS, SourceSpec
from omniocc.data.store.frame import RecordedFrame
from omniocc.data.store.meta import append_frame, finish_scene, panorama_of, recorded_spec
from omniocc.data.store.reader import BOXES, LIDAR_POSITION, SceneReader
from omniocc.data.store.shard import SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders.log import (
    Log,
    Plan,
    Timing,
    at_height,
    check_timing,
    missing_lines,
    moved_boxes,
    plan_frames,
)
from omniocc.extras.recorders.turns import at_one_time
from omniocc.frame import Box
from omniocc.io import checked_name
from omniocc.parallel import Report, make_scenes
from omniocc.progress import Progress

SHORTEST_S, LONGEST_S = 5e-4, 60.0
"""Limits of the median time between frames, s: beyond them the unit of the times is taken to be wrong."""
ONE_FRAME_S = 0.1
"""Stands for the time between frames of a scene that has only one, s."""
OFF_CENTRE_M = 0.5
"""A user is told when the ego origin is horizontally farther than this from the middle of the cameras."""


class SceneOptions(NamedTuple):
    """Facts about a scene that no file of its log gives.

    Attributes:
        image_size: width and height of the recorded images, px; None: the size in the first camera's calibration.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        road_z_m: height of the road in the ego frame, m; None: the height in the rig.
        moving: whether anything but the car moves in the scene; None: not stated.
    """

    image_size: Sequence[int] | None
    panorama: Sequence[float]
    road_z_m: float | None
    moving: bool | None


class LogRecorder(ABC):
    """Base class of the recorders of logs, which are folders of files, ROS bags or logs of py123d.

    Args:
        name: name of the scene and of its folder.
        timing: which samples make a frame.
        options: facts that no file of the log gives.
        origin_above_road_m: height of the recorded ego origin above the road, m; None: the origin stays that of the
            rig, the poses and the points.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(self, name: str, timing: Timing, options: SceneOptions, origin_above_road_m: float | None):
        self.name, self.timing, self.options = check_name(name), check_timing(timing), options
        if origin_above_road_m is not None and not origin_above_road_m > 0:
            raise ValueError(f"origin_above_road_m is {origin_above_road_m}; it must be above 0")
        self.origin_above_road_m = origin_above_road_m
        panorama_of(options.panorama)

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
            options = self.options
            if self.origin_above_road_m is not None:
                log = at_height(log, self.origin_above_road_m, road_of(log.rig, options))
                options = options._replace(road_z_m=None)
            return [record_log(log, Path(root) / self.name, self.timing, options)]


def record_log(log: Log, folder: Path, timing: Timing, options: SceneOptions) -> Path:
    """Write the scene of a log and return its folder; a scene made from the same log is returned as it is.

    Raises:
        UserError: naming the option that is impossible.
        DataError: naming the file that is damaged, or the folder that holds another scene.
    """
    plan = plan_frames(log, timing)
    rig = _scale_rig(log.rig, options)
    recipe = _hash_recipe(log, plan, rig, timing, options)
    if _is_made(folder, recipe):
        print(f"{folder} is there already, made from the same log with the same options")
        return folder
    with Progress(f"recording {folder}", len(plan.times_s)) as progress:
        lens_lines = lenses_that_do_not_fit(rig)
        plan_messages = *plan_lines(plan, log.place), *missing_lines(plan), *turn_lines(log, plan)
        for line in (*name_lines(folder.name), *plan_messages, *lens_lines, *origin_lines(rig)):
            progress.message(line)
        assert rig.road_z_m is not None
        reach_m = spec_of_log(log, plan, rig.road_z_m).reach_m
        check_points(log, plan, reach_m)
        reasons: list[str] = []
        work = partial(_write_scene, log=log, plan=plan, rig=rig, options=options, recipe=recipe, reasons=reasons)
        make_scenes(work, [folder], 0, progress)
        if reasons:
            frames = f"{len(reasons)} of {len(plan.times_s)} frames have hardly any points, in the first of them"
            progress.message(f"scene '{folder.name}': {frames} {reasons[0]}")
    _is_made(folder, recipe)  # raises if another process has made a different scene of this name meanwhile
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
    """Return a line if `data=recorded` does not find the scene by this name alone; else none."""
    if name.startswith(tuple(f"{split}-" for split in SPLITS)):
        return []
    starts = ", ".join(f"{split}-" for split in SPLITS)
    return [
        f"data=recorded reads names that begin with one of {starts}; '{name}' has to be named in data.source.splits"
    ]


def origin_lines(rig: Rig) -> list[str]:
    """Return a line if the ego origin, around which depth is searched, is not between the cameras; else none."""
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
        UserError: if the median time between frames is implausible for the cameras of a car.
    """
    count = len(plan.times_s)
    if count < 2:
        return ["1 frame"]
    step_s = float(np.median(np.diff(plan.times_s)))
    if not SHORTEST_S <= step_s <= LONGEST_S:
        raise UserError(
            f"{place}: the frames are {step_s:.3g} s apart, which is implausible for a car; is the unit of the times "
            "right (time_unit, poses_time_unit)?"
        )
    return [f"{count} frames, {plan.times_s[-1] - plan.times_s[0]:.1f} s, {step_s:.3g} s apart"]


def turn_lines(log: Log, plan: Plan) -> list[str]:
    """Return a line if the points have times, so that the motion of the car within a turn is corrected; else none."""
    if plan.scans is None or log.scans is None or log.scans.read(int(plan.scans[0])).times_s is None:
        return []
    return ["the points have times: the car's motion within a turn of the LiDAR is corrected (lidar.deskew)"]


def check_points(log: Log, plan: Plan, reach_m: float) -> None:
    """Check that some frame has enough points within reach; reading ends at the first that has.

    A frame whose points are beyond reach is accepted if their median distance is plausible for a LiDAR: it may only
    look far ahead.

    Raises:
        DataError: naming the likely reason, before anything is written.
    """
    if plan.scans is None or log.scans is None:
        return
    first_reason = ""
    for number in range(len(plan.scans)):
        points = read_points(log, plan, number)
        assert points is not None
        reason, distance_m = out_of_reach(points.points_m, reach_m), distances_m(points.points_m)
        if not reason or (len(distance_m) and np.median(distance_m) < FAR_M):
            return
        first_reason = first_reason or reason
    if first_reason:
        name = log.scans.name(int(plan.scans[0]))
        raise DataError(
            f"{name}: all {len(plan.scans)} frames have hardly any points, in the first of them {first_reason}"
        )


def _hash_recipe(log: Log, plan: Plan, rig: Rig, timing: Timing, options: SceneOptions) -> str:
    """Return a hash of all that decides the frames, except the content of images and scans."""
    parts = [
        part.tobytes().hex()
        for part in (plan.times_s, plan.images, plan.world_from_ego, plan.scans, plan.ego_from_scan)
        if part is not None
    ]
    settings = [list(timing), list(options), rig.fingerprint, dict(log.facts), list(log.inputs)]
    return digest([*parts, repr(settings), [] if log.scans is None else log.scans.classes.to_dict()])


def road_of(rig: Rig, options: SceneOptions) -> float:
    """Return the height of the road in the ego frame, m; raise UserError if neither options nor rig state it."""
    road_z_m = rig.road_z_m if options.road_z_m is None else options.road_z_m
    if road_z_m is None:
        raise UserError("the height of the road is not known: give road_z_m, m, in the ego frame, or in the rig file")
    return road_z_m


def _scale_rig(rig: Rig, options: SceneOptions) -> Rig:
    road_z_m, first = road_of(rig, options), rig.cameras[0]
    width, height = (first.width, first.height) if options.image_size is None else map(int, options.image_size)
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
    """Return the facts of the scene: its classes, the bands of the virtual world, the median time between frames."""
    steps_s = np.diff(plan.times_s)
    # rounded, to be equal for scenes of the same sensors
    interval_s = float(f"{np.median(steps_s):.2g}") if len(steps_s) else ONE_FRAME_S
    classes = OCCUPANCY_CLASSES if log.scans is None else log.scans.classes
    return recorded_spec(classes, interval_s, road_z_m)


def _write_scene(
    folder: Path, report: Report, log: Log, plan: Plan, rig: Rig, options: SceneOptions, recipe: str, reasons: list[str]
) -> None:
    """Write all frames; add to `reasons` a line for each with hardly any points within reach."""
    if folder.exists():  # another process has made it while this one waited
        report(len(plan.times_s))
        return
    assert rig.road_z_m is not None
    panorama, positions_m = panorama_of(options.panorama), list[list[float]]()
    with closing(SceneWriter(folder)) as writer:
        spec = spec_of_log(log, plan, rig.road_z_m)
        for number in range(len(plan.times_s)):
            frame, position_m = read_frame(log, plan, number, rig, panorama)
            positions_m += [] if position_m is None else [position_m.tolist()]
            if frame.points_m is not None and (reason := out_of_reach(frame.points_m, spec.reach_m)):
                reasons.append(reason)
            append_frame(writer, frame)
            report(1)
        facts = {"log": dict(log.facts), "start_s": float(plan.times_s[0]), "moving": options.moving}
        facts |= {} if log.scans is None else {LIDAR_POSITION: positions_m}
        facts |= {} if log.scans is None or log.scans.boxes is None else {BOXES: True}
        facts["missing"] = [{"time_s": time_s, "lacks": names} for time_s, names in plan.missing]
        edges_deg = panorama.top_deg, panorama.bottom_deg
        finish_scene(writer, rig, spec, edges_deg, facts | {"recipe": recipe})


def read_frame(
    log: Log, plan: Plan, number: int, rig: Rig, panorama: Equirectangular
) -> tuple[RecordedFrame, np.ndarray | None]:
    """Return one frame of a log at the size of `rig`; with a LiDAR also its points and their ranges in all images.

    The second is where its rays start, (3,), m, in the ego frame; None without a LiDAR.

    Raises:
        DataError: naming the image or scan that is damaged.
    """
    images = []
    for camera, (calibrated, scaled) in enumerate(zip(log.rig.cameras, rig.cameras, strict=True)):
        image, where = log.read_image(camera, int(plan.images[number, camera]))
        images.append(scale_image(image, calibrated, (scaled.width, scaled.height), where))
    frame = RecordedFrame(float(plan.times_s[number] - plan.times_s[0]), plan.world_from_ego[number], np.stack(images))
    cloud = read_points(log, plan, number)
    if cloud is None:
        return frame, None
    frame = replace(
        frame,
        range_m=np.stack([image.range_m for image in onto_cameras(cloud.points_m, None, rig)]),
        erp_range_m=onto_panorama(cloud.points_m, None, panorama).range_m,
        points_m=cloud.points_m,
        point_labels=cloud.labels,
        boxes=read_boxes(log, plan, number),
    )
    return frame, cloud.origin_m


def read_points(log: Log, plan: Plan, number: int) -> Cloud | None:
    """Return the points of a frame's scan in its ego frame; None without a LiDAR, DataError for a damaged scan.

    The car moves between the times of the frame and of the scan, and so does the origin of the rays. In a turn whose
    points have times it is where the LiDAR was at their median.
    """
    if log.scans is None or plan.scans is None:
        return None
    points, times_s = log.scans.read(int(plan.scans[number]))
    points_m = np.concatenate([points.points_m, log.scans.position_m[None]]).astype(np.float32)
    if times_s is not None:
        times_s = np.append(times_s, np.median(times_s))
        points_m = at_one_time(points_m, times_s, log.pose_times_s, log.world_from_ego, plan.world_from_ego[number])
    elif plan.ego_from_scan is not None:
        points_m = transform_points(plan.ego_from_scan[number], points_m).astype(np.float32)
    return Cloud(points_m[:-1], points.labels, points_m[-1])


def read_boxes(log: Log, plan: Plan, number: int) -> tuple[Box, ...]:
    """Return the boxes of actors of a frame's scan in its ego frame; none if the log has none."""
    if log.scans is None or log.scans.boxes is None or plan.scans is None:
        return ()
    boxes = log.scans.boxes(int(plan.scans[number]))
    return boxes if plan.ego_from_scan is None else moved_boxes(boxes, plan.ego_from_scan[number])


def scale_image(
    image: UInt8[np.ndarray, "h w 3"], camera: Camera, size: tuple[int, int], where: str
) -> UInt8[np.ndarray, "height width 3"]:
    """Return an image scaled to `size` (width, height); raise DataError if it is not of the camera's aspect ratio."""
    check_aspect((image.shape[1], image.shape[0]), camera, where)
    return scaled_to(image, size)


def check_name(name: str) -> str:
    """Return the name of a scene; raise ValueError if its folder cannot have this name, as with a point in it."""
    if "." in name:
        raise ValueError(f"name is '{name}'; it names a folder: no point, no slash, such as train-000-town")
    return checked_name("name", name)
