"""Log frames on a time line, one after the other."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float32
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.data.source import LidarScan
from omniocc.data.store.codec import SKY_CODE, STEPS_PER_M, quantize_range
from omniocc.extras.viewer.collect import with_progress
from omniocc.extras.viewer.frames import FramePrediction, Shown, ShownFrame
from omniocc.extras.viewer.timeline.shapes import (
    Mesh,
    camera_outline,
    class_meshes,
    difference_meshes,
    ray_outcomes,
    region_mesh,
)
from omniocc.extras.viewer.timeline.sinks import to_file, to_own_viewer, to_viewer
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.predict.output.range_files import point_cloud

EntityPath = list[str]
"""Parts of an entity path; each may hold any characters, which Rerun escapes."""
WORLD: EntityPath = ["world"]
EGO: EntityPath = ["world", "ego"]
"""Everything below moves with the car."""
TRAJECTORY: EntityPath = [*WORLD, "trajectory"]
CAMERAS: EntityPath = [*EGO, "cameras"]
LIDAR: EntityPath = [*EGO, "lidar"]
VOXELS: EntityPath = [*EGO, "voxels"]
DIFFERENCES: EntityPath = [*EGO, "differences"]
CANDIDATES: EntityPath = [*EGO, "candidates"]
RAYS: EntityPath = [*EGO, "rays"]
POINTS: EntityPath = [*EGO, "points"]
IMAGES: EntityPath = ["images"]
RANGES: EntityPath = ["ranges"]
FIGURES: EntityPath = ["figures"]
DESCRIPTION: EntityPath = ["frame"]
TRUTH = "truth"
Ranges = tuple[Float32[Tensor, "h w"], Equirectangular]
"""A panorama of ranges, m, and its directions."""
JPEG_QUALITY = 85
FARTHEST_M = 50.0
"""Range at the end of the colours of depth images."""
HIT_RGB, MISS_RGB = (0, 158, 115), (213, 94, 0)
CANDIDATE_RGB, CAMERA_RGB, PATH_RGB = (120, 130, 150), (90, 90, 90), (0, 114, 178)
EVERYWHERE = (CAMERAS, TRAJECTORY)
"""What is drawn in every view of the space around the car."""
EYE_M, TARGET_M = (-28.0, 0.0, 22.0), (0.5, 0.0, -3.0)
"""Where the eye begins, and what it looks at, m, ego frame: as in `omniocc.draw.voxels`."""
MODEL_PARTS = {
    "prediction": VOXELS,
    "differences": DIFFERENCES,
    "rays": RAYS,
    "candidates": CANDIDATES,
    "ranges": POINTS,
}
"""Views of a model, one of which is in front."""


class Timeline:
    """Logs frames to a recording in the order in which they come.

    Args:
        recording: that takes the data: a file, or a viewer.
        classes: of voxels and pixels.
        directions: (R, 3) unit rays of RayIoU, ego frame.
        frame_interval_s: time between the last frame of a scene and the first of the next on the time line, s.
    """

    def __init__(self, recording: rr.RecordingStream, classes: ClassTable, directions: Tensor, frame_interval_s: float):
        self.recording, self.classes, self.directions = recording, classes, directions
        self.interval_s = frame_interval_s
        self.count, self.scene, self.scene_began_s, self.now_s = 0, "", 0.0, -frame_interval_s
        self.origin_m, self.path = np.zeros(3), [np.zeros(3)]
        self.rig: Rig | None = None
        self.shown: set[str] = set()
        self.before: set[str] = set()
        recording.set_log_tick_enabled(False)
        recording.set_log_time_enabled(False)
        self._log([], class_names(classes), static=True)
        self._log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add(self, frame: ShownFrame, ranges: Mapping[str, Ranges] = MappingProxyType({})) -> None:
        """Log a frame after the ones before, with further panoramas of range by name; what it lacks is cleared."""
        if self.count == 0:
            self.recording.send_blueprint(layout(frame, tuple(ranges)))
        self._advance(frame)
        self._car(frame)
        self._images(frame)
        self._panorama(TRUTH, frame, frame.range_m, frame.panorama)
        for name, (range_m, panorama) in ranges.items():
            self._panorama(name, frame, range_m, panorama)
        if frame.lidar is not None:
            self._log(LIDAR, lidar_points(frame.lidar, self.classes))
        for grid, labels in frame.truth.items():
            self._meshes([*VOXELS, truth_name(grid)], class_meshes(labels, grid, self.classes))
        for name, prediction in frame.predictions.items():
            self._prediction(model_name(name), frame, prediction)
        for path in self.before - self.shown:
            self.recording.log(path, rr.Clear(recursive=False))
        self.before, self.shown = self.shown, set()

    def _advance(self, frame: ShownFrame) -> None:
        if frame.scene != self.scene or self.count == 0:
            self.scene, self.scene_began_s = frame.scene, self.now_s + self.interval_s - frame.time_s
            self.path = []
            if frame.world_from_ego is not None:  # metres of a map would not fit into 32 bits
                self.origin_m = frame.world_from_ego[:3, 3].copy()
        self.now_s = max(self.now_s, self.scene_began_s + frame.time_s)
        self.recording.set_time("frame", sequence=self.count)
        self.recording.set_time("time", duration=self.now_s)
        self.count += 1
        self._log(DESCRIPTION, rr.TextDocument(description(frame), media_type=rr.MediaType.TEXT))

    def _car(self, frame: ShownFrame) -> None:
        if frame.world_from_ego is not None:
            pose = frame.world_from_ego
            self.path.append(pose[:3, 3] - self.origin_m)
            self._log(EGO, rr.Transform3D(translation=self.path[-1], mat3x3=pose[:3, :3]))
            self._log(TRAJECTORY, rr.LineStrips3D([self.path], colors=[PATH_RGB], radii=0.08))
        self._cameras(frame.rig)

    def _cameras(self, rig: Rig | None) -> None:
        """Log where the cameras are, unless that is as before."""
        for k, name in enumerate(() if rig is None else rig.names):
            path = [*CAMERAS, name]
            self.shown.add(rr.new_entity_path(path))
            if rig is not None and rig != self.rig:
                self._log(path, rr.LineStrips3D(camera_outline(rig, k), colors=[CAMERA_RGB], radii=0.01))
        self.rig = rig

    def _images(self, frame: ShownFrame) -> None:
        if not frame.images:  # of a bag, or gone
            return
        names = frame.rig.names if frame.rig is not None else [f"{k}" for k in range(len(frame.images))]
        for k, (name, image) in enumerate(zip(names, frame.images, strict=True)):
            self._log([*IMAGES, name], rr.Image(image).compress(JPEG_QUALITY))
            for model, prediction in frame.predictions.items():
                if prediction.pixel_labels is not None:
                    size = image.shape[1], image.shape[0]
                    labels = np.asarray(
                        cv2.resize(prediction.pixel_labels[k], size, interpolation=cv2.INTER_NEAREST), np.uint8
                    )
                    path = [*IMAGES, name, model_name(model)]
                    self._log(path, rr.SegmentationImage(labels, opacity=0.5))

    def _prediction(self, name: str, frame: ShownFrame, prediction: FramePrediction) -> None:
        grid, truth = prediction.grid, frame.truth.get(prediction.grid)
        assert isinstance(grid, Cylinder | Cuboid)
        self._meshes([*VOXELS, name], class_meshes(prediction.labels, grid, self.classes))
        if prediction.candidates is not None and prediction.candidates.any():
            self._log([*CANDIDATES, name], triangles(region_mesh(prediction.candidates, grid, CANDIDATE_RGB)))
        self._panorama(name, frame, prediction.range_m, prediction.panorama)
        if truth is not None:
            self._meshes([*DIFFERENCES, name], difference_meshes(truth, prediction.labels, grid))
            outcomes = ray_outcomes(truth, prediction.labels, grid, self.classes, self.directions)
            self._log([*RAYS, name, "hits"], rr.Points3D(outcomes.hits_m, colors=[HIT_RGB], radii=0.06))
            self._log([*RAYS, name, "misses"], rr.LineStrips3D(outcomes.misses_m, colors=[MISS_RGB], radii=0.02))
        for key, value in prediction.figures.items():
            if np.isfinite(value):
                self._log([*FIGURES, key, name], rr.Scalars(value))

    def _panorama(
        self, name: str, frame: ShownFrame, range_m: Float32[Tensor, "h w"] | None, panorama: Equirectangular | None
    ) -> None:
        if range_m is None:
            return
        self._log([*RANGES, name], depth_image(range_m.numpy()))
        if panorama is not None and frame.rig is not None and frame.images:
            cloud = point_cloud(range_m, panorama, frame.images, frame.rig)
            known = cloud.points_m.isfinite().all(-1)
            points = rr.Points3D(cloud.points_m[known].numpy(), colors=cloud.colors[known].numpy(), radii=0.05)
            self._log([*POINTS, name], points)

    def _meshes(self, path: EntityPath, meshes: Mapping[str, Mesh]) -> None:
        for name, mesh in meshes.items():
            self._log([*path, name], triangles(mesh))

    def _log(self, path: Sequence[str], entity: rr.AsComponents | Iterable, static: bool = False) -> None:
        place = rr.new_entity_path(list(path))
        self.recording.log(place, entity, static=static)
        if not static:
            self.shown.add(place)


def class_names(classes: ClassTable) -> rr.AnnotationContext:
    """Return names and colours of the classes; free or sky, and unknown, are transparent."""
    rows = [rr.AnnotationInfo(row.id, row.name, (*row.rgb, 0 if row.id == FREE else 255)) for row in classes.rows]
    return rr.AnnotationContext([*rows, rr.AnnotationInfo(UNKNOWN, "unknown", (0, 0, 0, 0))])


def triangles(mesh: Mesh) -> rr.Mesh3D:
    """Return a mesh as Rerun takes it."""
    return rr.Mesh3D(vertex_positions=mesh.points_m, vertex_colors=mesh.colors, triangle_indices=mesh.triangles)


def depth_image(range_m: np.ndarray) -> rr.DepthImage:
    """Return a panorama of ranges in steps of 1/256 m; 0, no range, where it is unknown or sky."""
    codes = quantize_range(range_m)
    codes[codes == SKY_CODE] = 0
    return rr.DepthImage(codes, meter=float(STEPS_PER_M), depth_range=(0, FARTHEST_M * STEPS_PER_M))


def lidar_points(scan: LidarScan, classes: ClassTable) -> rr.Points3D:
    """Return the hits of a LiDAR in the colours of their classes."""
    hit = np.isfinite(scan.range_m)
    points = scan.range_m[hit, None] * scan.directions[hit]
    if scan.origins is not None:
        points = points + scan.origins[hit]
    return rr.Points3D(points, colors=classes.palette[scan.labels[hit]], radii=0.04)


def description(frame: ShownFrame) -> str:
    """Return a frame's name and figures in words, as plain text."""
    lines = [f"{frame.scene}", f"frame {frame.frame}, {frame.time_s:.2f} s"]
    for name, prediction in frame.predictions.items():
        figures = ", ".join(f"{key} {value:.3f}" for key, value in prediction.figures.items())
        lines.append(f"{name}: {figures or 'no truth to score against'}")
    return "\n".join(lines)


def layout(frame: ShownFrame, ranges: Sequence[str] = ()) -> rrb.Blueprint:
    """Return views for what a frame holds, and for further ranges; the same serve the frames after it."""
    names = [model_name(name) for name in frame.predictions]
    truth = [_space(truth_name(grid), [*VOXELS, truth_name(grid)]) for grid in frame.truth]
    if frame.lidar is not None:
        truth.append(_space("LiDAR", LIDAR))
    if frame.range_m is not None:
        truth.append(_space("true ranges", [*POINTS, TRUTH]))
    truth += [_space(f"ranges: {name}", [*POINTS, name]) for name in ranges]
    columns = [rrb.Tabs(*truth, name="truth")] if truth else []
    columns += [
        rrb.Tabs(*[_space(f"{name}: {part}", [*path, name]) for part, path in MODEL_PARTS.items()]) for name in names
    ]
    below = [*_images(frame, names), *_ranges(frame, ranges)]
    if names:
        below.append(rrb.TimeSeriesView(origin=_text([*FIGURES, "rayiou"]), name="RayIoU of each frame"))
    below.append(rrb.TextDocumentView(origin=_text(DESCRIPTION), name="frame"))
    rows = [rrb.Horizontal(*columns), rrb.Horizontal(*below)]
    panels = [
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(timeline="frame", state="expanded"),
    ]
    return rrb.Blueprint(rrb.Vertical(*rows, row_shares=[3, 2]), *panels)


def _images(frame: ShownFrame, models: Sequence[str]) -> list[rrb.Tabs]:
    """Return the cameras' images, plain and behind the classes of the pixels by each model."""
    if not frame.images:
        return []
    cameras = frame.rig.names if frame.rig is not None else [f"{k}" for k in range(len(frame.images))]

    def grid(title: str, model: str | None) -> rrb.Grid:
        views = []
        for camera in cameras:
            origin = [*IMAGES, camera]
            contents = [_text(origin)] if model is None else [_text(origin), _text([*origin, model])]
            views.append(rrb.Spatial2DView(origin=_text(origin), contents=contents, name=camera))
        return rrb.Grid(*views, grid_columns=3, name=title)

    seen = [model_name(name) for name, one in frame.predictions.items() if one.pixel_labels is not None]
    classes = [grid(f"{name}: classes of pixels", name) for name in models if name in seen]
    return [rrb.Tabs(grid("images", None), *classes)]


def _ranges(frame: ShownFrame, others: Sequence[str]) -> list[rrb.Vertical]:
    known = [*others]
    known += [] if frame.range_m is None else [TRUTH]
    known += [model_name(name) for name, one in frame.predictions.items() if one.range_m is not None]
    views = [rrb.Spatial2DView(origin=_text([*RANGES, name]), name=f"ranges: {name}") for name in known]
    return [rrb.Vertical(*views, name="ranges")] if views else []


def _space(title: str, path: Sequence[str]) -> rrb.Spatial3DView:
    contents = [f"+ {_text(part)}/**" for part in (path, *EVERYWHERE)]
    eye = rrb.EyeControls3D(position=EYE_M, look_target=TARGET_M, eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(origin=_text(EGO), contents=contents, name=title, eye_controls=eye)


def _text(parts: Sequence[str]) -> str:
    return rr.new_entity_path(list(parts))


def grid_name(grid: Grid) -> str:
    """Return a grid in words, such as `cylinder 64x100x8`."""
    return f"{type(grid).__name__.lower()} {'x'.join(map(str, grid.shape))}"


def truth_name(grid: Grid) -> str:
    """Return the name of the true voxels of a grid, beside the names of models."""
    return f"{TRUTH}, {grid_name(grid)}"


def model_name(name: str) -> str:
    """Return the name of a model on the time line; none is called as the truth is."""
    return f"model {name}" if name.startswith(TRUTH) else name


def show(shown: Shown, save: Path | None, connect: str | None) -> None:
    """Log all frames to the file `save`, to the viewer at `connect`, or, without both, to one that is started here.

    Raises:
        UserError: when there is no viewer.
        DataError: when the file cannot be written.
    """
    with sink(shown, save, connect) as recording:
        timeline = Timeline(recording, shown.classes, shown.directions, shown.frame_interval_s)
        for frame in with_progress(shown):
            timeline.add(frame)


def sink(shown: Shown, save: Path | None, connect: str | None) -> AbstractContextManager[rr.RecordingStream]:
    """Return the recording that takes the frames."""
    title = ", ".join(shown.models) or shown.source
    if save is not None:
        return to_file(save, title)
    return to_own_viewer(title) if connect is None else to_viewer(connect, title)
