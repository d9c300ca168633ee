"""Log frames on a time line, one after the other."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Float32
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.data.source import LidarScan
from omniocc.data.store.codec import SKY_CODE, STEPS_PER_M, quantize_range
from omniocc.extras.viewer.frames import FramePrediction, ShownFrame
from omniocc.extras.viewer.timeline import paths
from omniocc.extras.viewer.timeline.layout import layout
from omniocc.extras.viewer.timeline.meshes import Mesh, class_meshes, difference_meshes, region_mesh
from omniocc.extras.viewer.timeline.outlines import camera_outline
from omniocc.extras.viewer.timeline.rays import ray_outcomes
from omniocc.geometry import Cuboid, Cylinder
from omniocc.predict.output.range_files import point_cloud

Ranges = tuple[Float32[Tensor, "h w"], Equirectangular]
"""A panorama of ranges, m, and its directions."""
JPEG_QUALITY = 85
FARTHEST_M = 50.0
"""Range at the end of the colours of depth images."""
HIT_RGB, MISS_RGB = (0, 158, 115), (213, 94, 0)
CANDIDATE_RGB, CAMERA_RGB, PATH_RGB = (120, 130, 150), (90, 90, 90), (0, 114, 178)


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
        self._log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add(self, frame: ShownFrame, ranges: Mapping[str, Ranges] = MappingProxyType({})) -> None:
        """Log a frame after the ones before, with further panoramas of range by name; what it lacks is cleared."""
        if self.count == 0:
            self.recording.send_blueprint(layout(frame, tuple(ranges)))
        self._advance(frame)
        self._car(frame)
        self._images(frame)
        self._panorama(paths.TRUTH, frame, frame.range_m, frame.panorama)
        for name, (range_m, panorama) in ranges.items():
            self._panorama(name, frame, range_m, panorama)
        if frame.lidar is not None:
            self._log(paths.LIDAR, lidar_points(frame.lidar, self.classes))
        for grid, labels in frame.truth.items():
            self._meshes([*paths.VOXELS, paths.truth_name(grid)], class_meshes(labels, grid, self.classes))
        for name, prediction in frame.predictions.items():
            self._prediction(paths.model_name(name), frame, prediction)
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
        self._log(paths.DESCRIPTION, rr.TextDocument(description(frame), media_type=rr.MediaType.TEXT))

    def _car(self, frame: ShownFrame) -> None:
        if frame.world_from_ego is not None:
            pose = frame.world_from_ego
            self.path.append(pose[:3, 3] - self.origin_m)
            self._log(paths.EGO, rr.Transform3D(translation=self.path[-1], mat3x3=pose[:3, :3]))
            self._log(paths.TRAJECTORY, rr.LineStrips3D([self.path], colors=[PATH_RGB], radii=0.08))
        self._cameras(frame.rig)

    def _cameras(self, rig: Rig | None) -> None:
        """Log where the cameras are, unless that is as before."""
        for k, name in enumerate(() if rig is None else rig.names):
            path = [*paths.CAMERAS, name]
            self.shown.add(rr.new_entity_path(path))
            if rig is not None and rig != self.rig:
                self._log(path, rr.LineStrips3D(camera_outline(rig, k), colors=[CAMERA_RGB], radii=0.01))
        self.rig = rig

    def _images(self, frame: ShownFrame) -> None:
        names = frame.rig.names if frame.rig is not None else [f"{k}" for k in range(len(frame.images))]
        for k, (name, image) in enumerate(zip(names, frame.images, strict=True)):
            self._log([*paths.IMAGES, name], rr.Image(image).compress(JPEG_QUALITY))
            for model, prediction in frame.predictions.items():
                if prediction.pixel_labels is not None:
                    size = image.shape[1], image.shape[0]
                    labels = np.asarray(
                        cv2.resize(prediction.pixel_labels[k], size, interpolation=cv2.INTER_NEAREST), np.uint8
                    )
                    path = [*paths.IMAGES, name, paths.model_name(model)]
                    self._log(path, rr.SegmentationImage(labels, opacity=0.5))

    def _prediction(self, name: str, frame: ShownFrame, prediction: FramePrediction) -> None:
        grid, truth = prediction.grid, frame.truth.get(prediction.grid)
        assert isinstance(grid, Cylinder | Cuboid)
        self._meshes([*paths.VOXELS, name], class_meshes(prediction.labels, grid, self.classes))
        if prediction.candidates is not None and prediction.candidates.any():
            self._log([*paths.CANDIDATES, name], triangles(region_mesh(prediction.candidates, grid, CANDIDATE_RGB)))
        self._panorama(name, frame, prediction.range_m, prediction.panorama)
        if truth is not None:
            self._meshes([*paths.DIFFERENCES, name], difference_meshes(truth, prediction.labels, grid))
            outcomes = ray_outcomes(truth, prediction.labels, grid, self.classes, self.directions)
            self._log([*paths.RAYS, name, "hits"], rr.Points3D(outcomes.hits_m, colors=[HIT_RGB], radii=0.06))
            self._log([*paths.RAYS, name, "misses"], rr.LineStrips3D(outcomes.misses_m, colors=[MISS_RGB], radii=0.02))
        for key, value in prediction.figures.items():
            if np.isfinite(value):
                self._log([*paths.FIGURES, key, name], rr.Scalars(value))

    def _panorama(
        self, name: str, frame: ShownFrame, range_m: Float32[Tensor, "h w"] | None, panorama: Equirectangular | None
    ) -> None:
        if range_m is None:
            return
        self._log([*paths.RANGES, name], depth_image(range_m.numpy()))
        if panorama is not None and frame.rig is not None and frame.images:
            cloud = point_cloud(range_m, panorama, frame.images, frame.rig)
            known = cloud.points_m.isfinite().all(-1)
            points = rr.Points3D(cloud.points_m[known].numpy(), colors=cloud.colors[known].numpy(), radii=0.05)
            self._log([*paths.POINTS, name], points)

    def _meshes(self, path: paths.Path, meshes: Mapping[str, Mesh]) -> None:
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
