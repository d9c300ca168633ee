"""The sensors on the ego vehicle in one scene, cubes of flat cameras and semantic LiDARs, and what their bytes mean."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8, UInt32

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.cubemap import FACES, CubeLookup, look_up_rays
from omniocc.extras.unreal import SENSOR_FROM_OPTICAL, right_handed_points, unreal_pose
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
FAR_M = 1000.0
"""Distance that CARLA's depth encoding ends at; nothing but the sky is there."""
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
"""One point of the semantic LiDAR, 24 bytes; x, y, z in the sensor's Unreal frame.

https://carla.readthedocs.io/en/0.9.16/ref_sensors/ describes it and the images.
"""


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


def read_bgra(raw: bytes, height: int, width: int) -> UInt8[np.ndarray, "height width 4"]:
    """Return the pixels of a camera: blue, green, red, alpha; raise ValueError if there are fewer or more bytes."""
    if len(raw) != height * width * 4:
        raise ValueError(f"an image of {width}x{height} px has {len(raw)} bytes instead of {height * width * 4}")
    return np.frombuffer(raw, np.uint8).reshape(height, width, 4)


def rgb_of(pixels: UInt8[np.ndarray, "height width 4"]) -> UInt8[np.ndarray, "height width 3"]:
    """Return the colours."""
    return np.ascontiguousarray(pixels[..., 2::-1])


def tags_in(pixels: UInt8[np.ndarray, "height width 4"]) -> UInt8[np.ndarray, "height width"]:
    """Return the semantic tags: the red channel."""
    return np.ascontiguousarray(pixels[..., 2])


def inverse_depth_of(pixels: UInt8[np.ndarray, "height width 4"]) -> Float32[np.ndarray, "height width"]:
    """Return inverse distances along the optical axis, 1/m; 0 for the sky.

    The distance is 1000 (R + 256 G + 65536 B) / (2^24 - 1) m: planar, not along the ray.
    """
    blue, green, red = (pixels[..., channel].astype(np.float64) for channel in range(3))
    depth_m = FAR_M * (red + 256 * green + 65536 * blue) / (2**24 - 1)
    sky = depth_m > FAR_M * (1 - 1e-6)  # the last 17 of 2^24 values
    return np.where(sky, 0, 1 / np.maximum(depth_m, 1e-3)).astype(np.float32)


class Scan(NamedTuple):
    """Points of a semantic LiDAR.

    Attributes:
        points_m: (P, 3) in the right-handed frame of the sensor.
        actors: (P,) that were hit, by number; 0 for none.
        labels: (P,) our classes of their tags.
    """

    points_m: Float64[np.ndarray, "P 3"]
    actors: UInt32[np.ndarray, " P"]
    labels: UInt8[np.ndarray, " P"]


def read_scan(raw: bytes, classes: UInt8[np.ndarray, " 256"], own_actor: int) -> Scan:
    """Return the points of a semantic LiDAR without those of its own vehicle; raise ValueError if one is cut off."""
    found = read_points(raw)
    found = found[found["actor"] != own_actor]
    points_m = np.stack([found[axis] for axis in "xyz"], axis=1).astype(np.float64)
    return Scan(right_handed_points(points_m), found["actor"], classes[np.minimum(found["tag"], 255)])


def read_points(raw: bytes) -> np.ndarray:
    """Return the points of a semantic LiDAR, (P,) of `POINT`; raise ValueError if a point is cut off."""
    if len(raw) % POINT.itemsize:
        raise ValueError(f"a scan has {len(raw)} bytes, which is no multiple of {POINT.itemsize}")
    return np.frombuffer(raw, POINT)
