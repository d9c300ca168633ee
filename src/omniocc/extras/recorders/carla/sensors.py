"""The sensors that are mounted on the ego vehicle for one scene: cubes of flat cameras, and semantic LiDARs."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.cubemap import FACES, CubeLookup, look_up_rays
from omniocc.extras.unreal import SENSOR_FROM_OPTICAL, unreal_pose
from rayiou.directions import sparseocc_directions

CAMERAS = {
    "rgb": "sensor.camera.rgb",
    "depth": "sensor.camera.depth",
    "semantics": "sensor.camera.semantic_segmentation",
}
LIDAR = "sensor.lidar.ray_cast_semantic"
EVEN_LIGHT = {
    "exposure_mode": "manual",
    "motion_blur_intensity": 0,
    "bloom_intensity": 0,
    "lens_flare_intensity": 0,
    "chromatic_aberration_intensity": 0,
    "lens_circle_multiplier": 0,
}
"""Attributes of colour cameras without which the faces of a cube differ along their seams."""
ORIGIN = "origin"
FINEST_RAD = math.radians(0.5)
"""Angle between neighbouring pixels of the cube around the ego origin, for the LiDAR's rays 1 degree apart."""
SPREAD_M, LOW_M, HIGH_M = 20.0, 1.0, 5.0
"""The LiDARs beside the first stand up to this far ahead and aside of it, this high above the road (CarlaSC)."""
FIRST_M = (-0.5, 0.0, 1.8)
"""Place of the first LiDAR: over the roof, vehicle frame (CarlaSC)."""
CHANNELS, TOP_DEG, BOTTOM_DEG, REACH_M, COLUMNS = 64, 30.0, -60.0, 50.0, 2031
"""Of each LiDAR: CarlaSC's, but with a wider field, since theirs ends 2 degrees above the horizon."""

Spec = dict[str, Any]
"""A sensor as the capturing process needs it: name, blueprint, attributes, pose (`UnrealPose`) on the vehicle."""


@dataclass(frozen=True)
class Cube:
    """The flat cameras at one place, and where the rays of an image fall in them.

    Attributes:
        name: of the camera, or `origin`.
        ego_from_cube: pose, the frame of the cube being x right, y down, z forward.
        lookup: places of the rays in the faces.
        rays: unit rays in the frame of the cube.
        size: (height, width) of the image, px.
        pixels: numbers of its pixels that have a ray.
    """

    name: str
    ego_from_cube: Float64[np.ndarray, "4 4"]
    lookup: CubeLookup
    rays: Float64[np.ndarray, "P 3"]
    size: tuple[int, int]
    pixels: Int64[np.ndarray, " P"]

    def face_name(self, face: int, kind: str) -> str:
        """Return the name of one flat camera."""
        return f"{self.name}/{face}/{kind}"


def camera_cubes(rig: Rig) -> list[Cube]:
    """Return a cube for each camera of a rig, of any lens."""
    return [_camera_cube(rig, camera) for camera in range(len(rig.cameras))]


def _camera_cube(rig: Rig, camera: int) -> Cube:
    rays, valid = rig.rays(camera)
    pose = rig.ego_from_camera[camera].double().numpy()
    seen = valid.numpy()
    inside = seen[:, 1:] & seen[:, :-1]
    steps = np.linalg.norm((rays[:, 1:] - rays[:, :-1]).numpy()[inside], axis=-1)
    pixels = np.flatnonzero(seen)
    toward = pose[:3, :3].T @ rays.numpy().reshape(-1, 3)[pixels].T.astype(np.float64)
    height, width = seen.shape
    return Cube(rig.names[camera], pose, look_up_rays(toward, float(steps.mean())), toward.T, (height, width), pixels)


def origin_cube(panorama: Equirectangular) -> Cube:
    """Return the cube around the ego origin: rays of the panorama of ranges, then those of RayIoU's LiDAR."""
    rays = np.concatenate([panorama.rays().reshape(-1, 3).numpy(), sparseocc_directions().numpy()]).astype(np.float64)
    pixel_rad = min(2 * math.pi / panorama.width, FINEST_RAD)
    toward = SENSOR_FROM_OPTICAL[:3, :3].T @ rays.T
    lookup, count = look_up_rays(toward, pixel_rad), len(rays)
    return Cube(ORIGIN, SENSOR_FROM_OPTICAL, lookup, toward.T, (1, count), np.arange(count))


def cube_sensors(cube: Cube, vehicle_from_ego: Float64[np.ndarray, "4 4"], colour: Spec) -> list[Spec]:
    """Return the flat cameras of a cube, only of faces that are needed; `colour` are attributes of colour cameras."""
    kinds = ["depth", "semantics"] if cube.name == ORIGIN else list(CAMERAS)
    size = {"image_size_x": cube.lookup.side, "image_size_y": cube.lookup.side, "fov": cube.lookup.field_deg}
    sensors = []
    for face in cube.lookup.faces:
        optical = cube.ego_from_cube.copy()
        optical[:3, :3] = optical[:3, :3] @ FACES[face]
        pose = list(unreal_pose(vehicle_from_ego @ optical @ SENSOR_FROM_OPTICAL.T))
        for kind in kinds:
            attributes = size | (EVEN_LIGHT | colour if kind == "rgb" else {})
            name, blueprint = cube.face_name(face, kind), CAMERAS[kind]
            sensors.append({"name": name, "blueprint": blueprint, "attributes": attributes, "pose": pose})
    return sensors


def lidar_sensors(count: int, interval_s: float, seed: int) -> list[Spec]:
    """Return semantic LiDARs: the first over the roof, the others drawn around the vehicle; a turn each per frame."""
    rng = np.random.default_rng([seed, 31])
    places = rng.uniform((-SPREAD_M, -SPREAD_M, LOW_M), (SPREAD_M, SPREAD_M, HIGH_M), (count - 1, 3)).tolist()
    attributes = {
        "channels": CHANNELS,
        "upper_fov": TOP_DEG,
        "lower_fov": BOTTOM_DEG,
        "range": REACH_M,
        "rotation_frequency": 1 / interval_s,
        "points_per_second": round(CHANNELS * COLUMNS / interval_s),
    }
    return [
        {"name": f"lidar/{k}", "blueprint": LIDAR, "attributes": attributes, "pose": [x, -y, z, 0.0, 0.0, 0.0]}
        for k, (x, y, z) in enumerate([FIRST_M, *places])
    ]
