"""Frames as the virtual world's, from what CARLA's sensors send in one tick."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, UInt8

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.cubemap import blend_ranges
from omniocc.classes import FREE, UNKNOWN, WORLD_CLASSES
from omniocc.data.formats.poses import inverse, shift, transform_points
from omniocc.extras.carla_tags import ROAD, ROADLINE
from omniocc.extras.recorders.carla.sensors import Cube, Scan, inverse_depth_of, read_bgra, read_scan, rgb_of, tags_in
from omniocc.extras.unreal import right_handed, right_handed_points
from omniocc.frame import Box
from omniworld import Frame
from omniworld.render.own_car import road_of
from omniworld.scene import ego_box
from omniworld.sensors.thinning import SCRATCH, cubes, first_of_each, within_reach
from omniworld.traffic.traffic import Actor

MAX_BEND, MAX_STEP = 0.02, 0.3
"""Largest deviation from a plane and largest difference of four blended inverse depths, as fractions of the largest."""
SAME_M, SAME_FRACTION = 0.2, 0.03
"""Largest difference between a point's range and the range in an image that shows it; the larger of the two counts."""
OWN_CAR_M = 0.08
"""Distance from the own car's box up to which surfaces are the own car."""
ACTOR_CLASSES = {"vehicle": WORLD_CLASSES.names.index("Vehicle"), "walker": WORLD_CLASSES.names.index("Pedestrian")}
NEAR_M = 80.0
"""Horizontal distance from the ego origin up to which boxes are kept."""


@dataclass(frozen=True)
class RawFrame:
    """What the capturing process sends for one tick.

    Attributes:
        number: number of the tick, counted by the server.
        time_s: time of the simulation.
        world_from_vehicle: matrix of the ego vehicle, Unreal's frames.
        ego_id: number of the ego vehicle among the actors.
        ego_box: centre and half size of its box, m, in its Unreal frame.
        actors: vehicles and walkers, each with id, kind, matrix, center, extent and velocity, Unreal's world frame.
        matrices: `world_from_sensor` of every sensor, Unreal's frames.
        raw: bytes of every sensor by name.
    """

    number: int
    time_s: float
    world_from_vehicle: list[list[float]]
    ego_id: int
    ego_box: tuple[list[float], list[float]]
    actors: list[dict[str, Any]]
    matrices: dict[str, list[list[float]]]
    raw: dict[str, bytes]


class CubeImage(NamedTuple):
    """What the P rays of a cube see.

    Attributes:
        labels: classes; 0 sky, 255 unlabelled or own car.
        range_m: from the cube's centre, m; inf sky, nan own car.
        rgb: colours; black where no colour camera is mounted.
        own_car: whether the own car is seen.
    """

    labels: UInt8[np.ndarray, " P"]
    range_m: Float32[np.ndarray, " P"]
    rgb: UInt8[np.ndarray, "P 3"]
    own_car: Bool[np.ndarray, " P"]


class OwnBox(NamedTuple):
    """The own car's box in the ego frame: lowest and highest corner, m."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]

    def holds(self, points_m: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
        """Return which points (ego frame, m) are in the box or near it."""
        return np.all((points_m > self.low - OWN_CAR_M) & (points_m < self.high + OWN_CAR_M), axis=1)


def own_box(raw: RawFrame, ego_from_vehicle: Float64[np.ndarray, "4 4"]) -> OwnBox:
    """Return the box of the own car, which stands level in the ego frame."""
    center, extent = (np.array(part, np.float64) for part in raw.ego_box)
    middle = transform_points(ego_from_vehicle, right_handed_points(center[None]))[0]
    return OwnBox(middle - extent, middle + extent)


def see(cube: Cube, raw: dict[str, bytes], classes: UInt8[np.ndarray, " 256"], own: OwnBox) -> CubeImage:
    """Return what a cube's rays see: colours blended, classes of the nearest pixel, ranges exact on planes.

    Raises:
        ValueError: naming the camera whose data has another size.
    """
    lookup, side = cube.lookup, cube.lookup.side
    inverse_depth = np.zeros((6, side, side), np.float32)
    tags = np.zeros((6, side, side), np.uint8)
    colors = np.zeros((6, side, side, 3), np.uint8)
    colored = cube.face_name(lookup.faces[0], "rgb") in raw
    for face in lookup.faces:
        inverse_depth[face] = inverse_depth_of(_read_pixels(cube, face, "depth", raw))
        tags[face] = tags_in(_read_pixels(cube, face, "semantics", raw))
        if colored:
            colors[face] = rgb_of(_read_pixels(cube, face, "rgb", raw))
    flat, found = inverse_depth.reshape(-1), classes[tags.reshape(-1)]
    labels = found[lookup.nearest]
    range_m = blend_ranges(lookup, flat, on_one_surface(flat[lookup.corner], tags.reshape(-1)[lookup.corner]))
    range_m = np.where(labels == FREE, np.inf, range_m)
    directions = _ego_rays(cube)
    hit = np.isfinite(range_m)
    points_m = cube.ego_from_cube[:3, 3] + directions * np.where(hit, range_m, 1e6)[:, None]  # 0 * inf would be nan
    car = hit & (labels == ACTOR_CLASSES["vehicle"]) & own.holds(points_m)  # the box holds road beside it as well
    rgb = np.einsum("cpk,cp->pk", colors.reshape(-1, 3)[lookup.corner], lookup.weight)
    return CubeImage(
        np.where(car, np.uint8(UNKNOWN), labels),
        np.where(car, np.nan, range_m).astype(np.float32),
        np.rint(rgb).astype(np.uint8),
        car,
    )


def on_one_surface(inverse_depth: Float32[np.ndarray, "4 P"], tags: UInt8[np.ndarray, "4 P"]) -> Bool[np.ndarray, " P"]:
    """Return where four pixels see one surface: inverse depths of a plane are linear in the image."""
    largest = inverse_depth.max(axis=0)
    bend = np.abs(inverse_depth[0] - inverse_depth[1] - inverse_depth[2] + inverse_depth[3])
    alike = (tags == tags[0]).all(axis=0)
    return alike & (bend <= MAX_BEND * largest) & (largest - inverse_depth.min(axis=0) <= MAX_STEP * largest)


def make_frame(
    raw: RawFrame,
    first_time_s: float,
    rig: Rig,
    cameras: list[Cube],
    origin: Cube,
    panorama: Equirectangular,
    classes: UInt8[np.ndarray, " 256"],
) -> tuple[Frame, list[Bool[np.ndarray, "height width"]]]:
    """Return a frame, and the pixels of every camera that show the own car.

    Args:
        raw: what was sent.
        first_time_s: time of the scene's first frame, from which times count.
        rig: cameras of the frame.
        cameras: cube of each camera.
        origin: cube around the ego origin (see `origin_cube`).
        panorama: directions of the ranges around the ego origin.
        classes: our class of every tag.

    Raises:
        ValueError: naming the sensor whose data has another size.
    """
    ego_from_vehicle = vehicle_in_ego(rig)
    world_from_ego = right_handed(np.array(raw.world_from_vehicle)) @ inverse(ego_from_vehicle)
    own = own_box(raw, ego_from_vehicle)
    seen = [see(cube, raw.raw, classes, own) for cube in cameras]
    rgb, semantics, range_m, own_car = (
        [_fill_image(cube, values, outside) for cube, values in zip(cameras, part, strict=True)]
        for part, outside in zip(
            (
                [image.rgb for image in seen],
                [image.labels for image in seen],
                [image.range_m for image in seen],
                [image.own_car for image in seen],
            ),
            (0, UNKNOWN, np.nan, False),
            strict=True,
        )
    )
    around = see(origin, raw.raw, classes, own)
    split = panorama.height * panorama.width  # the rays of the LiDAR follow the panorama's
    points_m, labels = points_of(raw, world_from_ego, classes)
    labels = with_road_lines(points_m, labels, rig, semantics, range_m)
    keep = first_of_each(cubes(points_m), labels, np.zeros(SCRATCH, np.int32))
    frame = Frame(
        time_s=raw.time_s - first_time_s,
        world_from_ego=world_from_ego,
        images=np.stack(rgb),
        semantics=np.stack(semantics),
        range_m=np.stack(range_m),
        erp_range_m=around.range_m[:split].reshape(panorama.height, panorama.width),
        points_m=points_m[keep],
        point_labels=labels[keep],
        lidar_range_m=around.range_m[split:],
        lidar_labels=around.labels[split:],
        boxes=boxes_of(raw, world_from_ego),
    )
    return frame, own_car


def vehicle_in_ego(rig: Rig) -> Float64[np.ndarray, "4 4"]:
    """Return `ego_from_vehicle`, a shift down to the road, where CARLA's vehicles have their origin."""
    return shift(0, 0, road_of(rig))


def points_of(
    raw: RawFrame, world_from_ego: Float64[np.ndarray, "4 4"], classes: UInt8[np.ndarray, " 256"]
) -> tuple[Float32[np.ndarray, "P 3"], UInt8[np.ndarray, " P"]]:
    """Return the points of all LiDARs in the ego frame, m, and their classes.

    Points of the own car, unlabelled points and points out of the voxels' reach are left out.
    """
    parts: list[np.ndarray] = [np.empty((0, 3), np.float32)]
    labels: list[np.ndarray] = [np.empty(0, np.uint8)]
    for world_from_lidar, scan in scans_of(raw, classes):
        points = transform_points(inverse(world_from_ego) @ world_from_lidar, scan.points_m).astype(np.float32)
        keep = within_reach(points) & (scan.labels != UNKNOWN) & (scan.labels != FREE)
        parts.append(points[keep])
        labels.append(scan.labels[keep])
    return np.concatenate(parts), np.concatenate(labels)


def scans_of(raw: RawFrame, classes: UInt8[np.ndarray, " 256"]) -> Iterator[tuple[Float64[np.ndarray, "4 4"], Scan]]:
    """Yield `world_from_lidar` (right-handed frames) and the points of every LiDAR, in the order in which they came."""
    for name, content in raw.raw.items():
        if name.startswith("lidar/"):
            yield right_handed(np.array(raw.matrices[name])), read_scan(content, classes, raw.ego_id)


def with_road_lines(
    points_m: Float32[np.ndarray, "P 3"],
    labels: UInt8[np.ndarray, " P"],
    rig: Rig,
    semantics: list[np.ndarray],
    range_m: list[np.ndarray],
) -> UInt8[np.ndarray, " P"]:
    """Return the classes, with points of the road as road lines where an image shows a road line at their range.

    CARLA's LiDARs see collision meshes, which have no markings (https://github.com/carla-simulator/carla/issues/3638).
    """
    changed, road = labels.copy(), np.flatnonzero(labels == ROAD)
    points = torch.from_numpy(points_m[road]).double()
    for camera in range(len(rig.cameras)):
        pixels, valid = rig.project_into(camera, points)
        index = np.flatnonzero(valid.numpy())
        column, row = pixels[valid].round().long().numpy().T
        measured = (points[valid] - rig.ego_from_camera[camera, :3, 3]).norm(dim=1).numpy()
        shown = range_m[camera][row, column]
        same = np.abs(shown - measured) < np.maximum(SAME_M, SAME_FRACTION * measured)
        changed[road[index[same & (semantics[camera][row, column] == ROADLINE)]]] = ROADLINE
    return changed


def boxes_of(raw: RawFrame, world_from_ego: Float64[np.ndarray, "4 4"]) -> tuple[Box, ...]:
    """Return the boxes of vehicles and walkers within `NEAR_M`, without the ego vehicle."""
    boxes = [ego_box(actor_of(actor), world_from_ego) for actor in raw.actors if actor["id"] != raw.ego_id]
    return tuple(box for box in boxes if np.hypot(box.center_m[0], box.center_m[1]) <= NEAR_M)


def actor_of(sent: dict[str, Any]) -> Actor:
    """Return a vehicle or walker that the capturing process sent, in the right-handed frames."""
    x, y, z = sent["center"]
    length, width, height = (2 * float(value) for value in sent["extent"])
    world_from_actor = right_handed(np.array(sent["matrix"])) @ shift(x, -y, z - height / 2)
    velocity = (float(sent["velocity"][0]), -float(sent["velocity"][1]))
    return Actor(sent["id"], ACTOR_CLASSES[sent["kind"]], world_from_actor, (length, width, height), velocity)


def _read_pixels(cube: Cube, face: int, kind: str, raw: dict[str, bytes]) -> UInt8[np.ndarray, "side side 4"]:
    name = cube.face_name(face, kind)
    try:
        return read_bgra(raw[name], cube.lookup.side, cube.lookup.side)
    except ValueError as error:
        raise ValueError(f"sensor {name}: {error}") from error


def _ego_rays(cube: Cube) -> Float64[np.ndarray, "P 3"]:
    """Return the unit rays of a cube in the ego frame."""
    return cube.rays @ cube.ego_from_cube[:3, :3].T


def _fill_image(cube: Cube, values: np.ndarray, outside: float) -> np.ndarray:
    height, width = cube.size
    image = np.full((height * width, *values.shape[1:]), outside, values.dtype)
    image[cube.pixels] = values
    return image.reshape(height, width, *values.shape[1:])
