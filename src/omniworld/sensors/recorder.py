"""Recording of one frame with all sensors: cameras, panorama of ranges, ego LiDAR and labelled points."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from omniocc.camera import Rig
from omniocc.frame import Box, Frame
from omniworld.render.capture import RenderedPixels, expose, render_pixels
from omniworld.render.caster import Caster
from omniworld.render.cubemap import make_cube, render_through_cube
from omniworld.render.light import Sensor
from omniworld.render.own_car import car_under, show_ego_car
from omniworld.render.snapshot import Snapshot
from omniworld.render.view import View, make_view
from omniworld.sensors.geometry_labels import GeometryLabels
from omniworld.sensors.lidar import ego_directions, panorama_directions, scan_ego
from omniworld.sensors.semantic_lidars import SemanticLidars

Capture = Literal["direct", "cubemap"]
Render = Callable[[Snapshot], RenderedPixels]
Labeller = SemanticLidars | GeometryLabels
"""A source of labelled surface points."""


class Recorder:
    """The sensors of one vehicle; all their rays are computed once. For the options see `omniworld.Scene`.

    The ego car is visible to the cameras and not to the LiDARs.
    """

    def __init__(
        self,
        rig: Rig,
        labeller: Labeller,
        supersample: int,
        capture: str,
        erp_size: tuple[int, int],
        erp_top_deg: float,
        erp_bottom_deg: float,
    ) -> None:
        self.views, self.renderers = make_cameras(rig, supersample, capture)
        self.erp_size = erp_size
        self._panorama = panorama_directions(*erp_size, erp_top_deg, erp_bottom_deg)
        self._ego_rays = np.ascontiguousarray(ego_directions().T)
        self.labeller = labeller

    def frame(
        self,
        snapshot: Snapshot,
        sensor: Sensor,
        seed: tuple[int, ...],
        time_s: float,
        world_from_ego: np.ndarray,
        boxes: tuple[Box, ...],
    ) -> Frame:
        """Record one time step; `seed` decides the sensors' noise."""
        images = [
            expose(view, render(snapshot), snapshot.light, sensor, np.random.default_rng([*seed, number]))
            for number, (view, render) in enumerate(zip(self.views, self.renderers, strict=True))
        ]
        rgb, semantics, range_m = (np.stack(part) for part in zip(*images, strict=True))
        points_m, labels = self.labeller.scan(snapshot)
        erp_range_m, lidar_range_m, lidar_labels = self.ranges(snapshot)
        return Frame(
            time_s,
            world_from_ego,
            rgb,
            semantics,
            range_m,
            erp_range_m,
            points_m=points_m,
            point_labels=labels,
            lidar_range_m=lidar_range_m,
            lidar_labels=lidar_labels,
            boxes=boxes,
        )

    def ranges(self, snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the panorama's ranges (h, w), and ranges and classes along the ego LiDAR's rays, as in `Frame`."""
        width, height = self.erp_size
        return scan_ego(snapshot, self._panorama)[0].reshape(height, width), *scan_ego(snapshot, self._ego_rays)


@lru_cache(maxsize=2)
def make_cameras(rig: Rig, supersample: int, capture: str) -> tuple[list[View], list[Render]]:
    """Return the rays of each camera, and what renders its image; scenes with the same rig share them."""
    caster, rig = Caster(car_under(rig)), show_ego_car(rig)
    views = [make_view(rig, camera, supersample, caster) for camera in range(len(rig.cameras))]
    if capture == "direct":
        return views, [partial(render_pixels, view) for view in views]
    cubes = [make_cube(rig, camera, view, supersample, caster) for camera, view in enumerate(views)]
    return views, [partial(render_through_cube, cube) for cube in cubes]
