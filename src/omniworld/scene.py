"""A scene: one sequence of frames through one place."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from omniocc import seeding
from omniocc.camera import Rig
from omniocc.frame import Box, Frame
from omniworld.assets.vehicle import EGO_ROAD_M
from omniworld.mesh.mesh import transform
from omniworld.mesh.repaint import repaint as repainted
from omniworld.render.caster import Caster, Layers
from omniworld.render.cull import spheres_of
from omniworld.render.light import lamp_pools
from omniworld.render.own_car import car_under, road_of
from omniworld.render.snapshot import Shadows, Snapshot
from omniworld.render.surface import SurfaceStack, make_surfaces
from omniworld.render.weather import WEATHERS, draw_light, draw_sensor, draw_weather
from omniworld.sensors.geometry_labels import GeometryLabels
from omniworld.sensors.recorder import Capture, Labeller, Recorder
from omniworld.sensors.semantic_lidars import SemanticLidars
from omniworld.town import place
from omniworld.traffic.traffic import Actor, Traffic

LabelMode = Literal["lidar20", "geometry"]


class Scene:
    """A deterministic sequence of (theme, seed): `frame(index)` is the same in every process and order of calls.

    Args:
        theme: one of `omniworld.THEMES`.
        seed: draws streets, traffic, light and noise.
        rig: cameras of the ego vehicle; the road is as far below its origin as it says, or else 2.2 m.
        frame_interval_s: time between frames.
        supersample: camera rays per pixel along each side where a pixel needs smoothing; 1 for one ray per pixel.
        erp_size: width and height of the panorama of ranges around the ego origin, px.
        erp_top_deg: elevation of the panorama's upper edge.
        erp_bottom_deg: elevation of its lower edge.
        weather: clear, overcast, rain, fog or dusk; None draws one by the seed.
        label_mode: lidar20 (virtual semantic LiDARs, as in the paper) or geometry (all surfaces, visible or not).
        lidars: number of virtual LiDARs of `lidar20`, the ego's included.
        capture: direct (a ray through every pixel) or cubemap (pixels looked up in six flat images, as in the paper).
        repaint: whether materials and colours of all that stands still are exchanged for others.

    Raises:
        ValueError: the theme does not exist, or an option is out of range.
        ImportError: Embree is not installed.
    """

    def __init__(
        self,
        theme: str,
        seed: int,
        rig: Rig,
        frame_interval_s: float = 0.1,
        supersample: int = 2,
        erp_size: Sequence[int] = (192, 48),
        erp_top_deg: float = 45.0,
        erp_bottom_deg: float = -45.0,
        weather: str | None = None,
        label_mode: str = "lidar20",
        lidars: int = 20,
        capture: str = "direct",
        repaint: bool = False,
    ) -> None:
        _check(frame_interval_s, supersample, erp_size, lidars)
        _check_names(weather, label_mode, capture)
        town = place.build(theme, seed)
        if repaint:
            town = replace(town, mesh=repainted(town.mesh, seeding.generator(theme, seed, "repaint")))
        self._interval_s = frame_interval_s
        self._seed = (seed, *theme.encode())
        self._traffic = Traffic(town, seed)
        self._ego_car = car_under(rig)
        self._lift_m = EGO_ROAD_M - road_of(rig)
        self._static = Caster(town.mesh)
        static_surfaces = make_surfaces(town.mesh)
        self._surfaces = SurfaceStack(static_surfaces)
        rng = seeding.generator(theme, seed, "light")
        drawn = draw_weather(rng)
        light = draw_light(drawn if weather is None else weather, rng)
        self._light = replace(light, pools=lamp_pools(town.mesh)) if light.lamps else light
        self.sensor = draw_sensor(rng, self._light)
        size = (int(erp_size[0]), int(erp_size[1]))
        labeller: Labeller = GeometryLabels(town.mesh)
        if label_mode == "lidar20":
            labeller = SemanticLidars(self._static, static_surfaces, town.terrain.height, lidars)
        self.recorder = Recorder(rig, labeller, supersample, capture, size, erp_top_deg, erp_bottom_deg=erp_bottom_deg)

    def frame(self, index: int) -> Frame:
        """Record the frame at `index * frame_interval_s` seconds; raise ValueError if the index is negative."""
        if index < 0:
            raise ValueError(f"frame {index}: frames are counted from 0")
        time_s = index * self._interval_s
        world_from_ego = self._world_from_ego(time_s)
        snapshot, actors = self.snapshot(time_s)
        boxes = tuple(ego_box(actor, world_from_ego) for actor in actors)
        return self.recorder.frame(snapshot, self.sensor, (*self._seed, index), time_s, world_from_ego, boxes)

    def snapshot(self, time_s: float) -> tuple[Snapshot, tuple[Actor, ...]]:
        """Return the world at a time, ready to be rendered, and its moving actors; valid until the next call."""
        world_from_ego = self._world_from_ego(time_s)
        moving_mesh, actors = self._traffic.actors(time_s)
        ego_mesh = transform(self._ego_car, world_from_ego)
        moving, spheres = Caster(moving_mesh), spheres_of(moving_mesh)
        in_light = np.concatenate([spheres, spheres_of(ego_mesh)])
        snapshot = Snapshot(
            Layers([self._static, moving]),
            Shadows(self._static, [moving, Caster(ego_mesh)], in_light, self._light),
            self._surfaces.topped([make_surfaces(moving_mesh), make_surfaces(ego_mesh)]),
            self._static.size + moving.size,
            world_from_ego[:3, :3].astype(np.float32),
            world_from_ego[:3, 3].astype(np.float32),
            moving=moving_mesh,
            spheres=spheres,
            light=self._light,
        )
        return snapshot, actors

    def _world_from_ego(self, time_s: float) -> np.ndarray:
        """Return the (4, 4) pose of the ego frame, whose origin is as high above the road as the rig's."""
        pose = self._traffic.world_from_ego(time_s)
        pose[:3, 3] += self._lift_m * pose[:3, 2]
        return pose


def ego_box(actor: Actor, world_from_ego: np.ndarray) -> Box:
    """Return an actor's box in the ego frame; its centre is half its height above the actor's origin."""
    ego_from_actor = np.linalg.inv(world_from_ego) @ actor.world_from_actor
    center = ego_from_actor[:3, :3] @ (0, 0, actor.size_m[2] / 2) + ego_from_actor[:3, 3]
    velocity = world_from_ego[:3, :3].T @ (*actor.velocity_mps, 0.0)
    yaw = np.arctan2(ego_from_actor[1, 0], ego_from_actor[0, 0])
    center_m = (float(center[0]), float(center[1]), float(center[2]))
    velocity_mps = (float(velocity[0]), float(velocity[1]))
    return Box(actor.id, actor.label, center_m, actor.size_m, float(yaw), velocity_mps)


def _check(frame_interval_s: float, supersample: int, erp_size: Sequence[int], lidars: int) -> None:
    if frame_interval_s <= 0:
        raise ValueError(f"frame_interval_s is {frame_interval_s}; give a positive time")
    if not 1 <= supersample <= 8:
        raise ValueError(f"supersample is {supersample}; give 1 to 8 rays per pixel along each side")
    if len(erp_size) != 2 or min(erp_size) < 1:
        raise ValueError(f"erp_size is {list(erp_size)}; give width and height in pixels, e.g. [192, 48]")
    if lidars < 1:
        raise ValueError(f"lidars is {lidars}; give 1 for only the ego's LiDAR, or more")


def _check_names(weather: str | None, label_mode: str, capture: str) -> None:
    for name, value, possible in (
        ("weather", weather, (None, *WEATHERS)),
        ("label_mode", label_mode, get_args(LabelMode)),
        ("capture", capture, get_args(Capture)),
    ):
        if value not in possible:
            raise ValueError(f"{name} is {value!r}; possible: {', '.join(map(str, possible))}")
