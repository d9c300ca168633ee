"""Everything one moment is recorded with: cameras, panorama of ranges, ego LiDAR and semantic LiDARs."""

from collections.abc import Callable
from functools import partial
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from omniocc.camera import Rig
from omniocc.world.assets.mesh import Mesh
from omniocc.world.frame import Box, Frame
from omniocc.world.render.capture import Look, Picture, expose, look
from omniocc.world.render.caster import Caster
from omniocc.world.render.cubemap import look_through, make_cube
from omniocc.world.render.light import Sensor
from omniocc.world.render.stage import Stage
from omniocc.world.render.view import make_view
from omniocc.world.sensors.lidar import ego_directions, scan_ego

Capture = Literal["direct", "cubemap"]


def panorama_directions(width: int, height: int, top_deg: float, bottom_deg: float) -> np.ndarray:
    """(3, height * width) float32 unit directions of an equirectangular picture (docs/design.md, frames and units)."""
    azimuth = np.pi - (np.arange(width) + 0.5) * (2 * np.pi / width)
    elevation = np.radians(top_deg - (np.arange(height) + 0.5) * ((top_deg - bottom_deg) / height))
    elevation, azimuth = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]).astype(np.float32)


@runtime_checkable
class Labeller(Protocol):
    """Where labelled surface points come from."""

    def scan(self, stage: Stage) -> tuple[np.ndarray, np.ndarray]:
        """Points (P, 3) float32 in the ego frame and their classes (P,) uint8."""
        ...


class Recorder:
    """The sensors of one vehicle; all their rays are worked out once.

    Args:
        rig: cameras.
        own_car: mesh in the ego frame, which the cameras see and the LiDARs do not.
        labeller: of the surface points.
        supersample: camera rays per pixel along each side where a pixel needs smoothing.
        capture: direct (a ray through every pixel) or cubemap (the paper's way).
        erp_size: width and height of the panorama of ranges, px.
        erp_top_deg: elevation of its upper edge.
        erp_bottom_deg: elevation of its lower edge.
    """

    def __init__(
        self,
        rig: Rig,
        own_car: Mesh,
        labeller: Labeller,
        supersample: int,
        capture: str,
        erp_size: tuple[int, int],
        erp_top_deg: float,
        erp_bottom_deg: float,
    ) -> None:
        caster = Caster(own_car)
        self.views = [make_view(rig, camera, supersample, caster) for camera in range(len(rig.cameras))]
        self.looks: list[Callable[[Stage], Look]] = [partial(look, view) for view in self.views]
        if capture == "cubemap":
            cubes = [make_cube(rig, k, view, supersample, caster) for k, view in enumerate(self.views)]
            self.looks = [partial(look_through, cube) for cube in cubes]
        self.erp_size = erp_size
        self._panorama = panorama_directions(*erp_size, erp_top_deg, erp_bottom_deg)
        self._ego_rays = np.ascontiguousarray(ego_directions().T)
        self.labeller = labeller

    def frame(
        self,
        stage: Stage,
        sensor: Sensor,
        seed: tuple[int, ...],
        time_s: float,
        world_from_ego: np.ndarray,
        boxes: tuple[Box, ...],
    ) -> Frame:
        """Records one moment; `seed` decides the sensors' noise."""
        pictures = [
            expose(view, see(stage), stage.light, sensor, np.random.default_rng([*seed, number]))
            for number, (view, see) in enumerate(zip(self.views, self.looks, strict=True))
        ]
        points_m, point_labels = self.labeller.scan(stage)
        erp_range_m, lidar_range_m, lidar_labels = self.ranges(stage)
        return Frame(
            time_s=time_s,
            world_from_ego=world_from_ego,
            images=_stack(pictures, 0),
            semantics=_stack(pictures, 1),
            range_m=_stack(pictures, 2),
            erp_range_m=erp_range_m,
            points_m=points_m,
            point_labels=point_labels,
            lidar_range_m=lidar_range_m,
            lidar_labels=lidar_labels,
            boxes=boxes,
        )

    def ranges(self, stage: Stage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The panorama's ranges (h, w), and ranges and classes along the ego LiDAR's rays; as in `Frame`."""
        width, height = self.erp_size
        return scan_ego(stage, self._panorama)[0].reshape(height, width), *scan_ego(stage, self._ego_rays)


def _stack(pictures: list[Picture], part: int) -> np.ndarray:
    return np.stack([picture[part] for picture in pictures])
