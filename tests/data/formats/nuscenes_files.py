"""Write a small dataset in the layout of nuScenes and Occ3D: tables, images, LiDAR points, labels."""

import json
from pathlib import Path

import cv2
import numpy as np

from omniocc.data.formats.nuscenes import CAMERAS, LIDAR

SIZE = (160, 90)
"""Width and height of the images, px, a tenth of nuScenes'."""
FOCAL_PX = 126.6
BEGIN_US = 1_532_402_927_000_000
EARLY_US = 40_000
"""Cameras take their images this long before the LiDAR stands at its middle."""
SPEED_MPS = 9.0
# w, x, y, z of cameras that look ahead, turned about z by these angles
YAWS_DEG = dict(zip(CAMERAS, (0, -55, 55, 180, 110, -110), strict=True))
AHEAD = (0.5, -0.5, 0.5, -0.5)
RING_M = 12.0
"""Radius of the round wall that LiDAR and labels show."""


def product(a, b):
    """Return the product of two quaternions w, x, y, z."""
    w, x, y, z = a
    v, p, q, r = b
    return [
        w * v - x * p - y * q - z * r,
        w * p + x * v + y * r - z * q,
        w * q - x * r + y * v + z * p,
        w * r + x * q - y * p + z * v,
    ]


def about_z(angle_deg):
    half = np.radians(angle_deg) / 2
    return [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]


def wall_points(sensor_z_m):
    """Points of road and round wall in the LiDAR's frame: x right, y forward, z up from the sensor."""
    turn = np.linspace(-np.pi, np.pi, 720, endpoint=False)

    def ring(radius_m, z_m):
        return np.stack([radius_m * np.sin(turn), radius_m * np.cos(turn), np.full_like(turn, z_m)], axis=1)

    wall = [ring(RING_M, z_m) for z_m in (-1.0, 0.0, 1.0)]
    road = [ring(radius_m, -sensor_z_m) for radius_m in (4.0, 7.0, 10.0)]
    points = np.concatenate([*wall, *road, [[0.1, 0.2, 0.0]]])  # the last is on the own car
    return np.concatenate([points, np.zeros((len(points), 2))], axis=1).astype("<f4")


def voxels(shape=(200, 200, 16), low=(-40.0, -40.0, -1.0), size=0.4):
    """Labels as in the files: driveable surface below, manmade walls around the ego origin, free (17) elsewhere."""
    x, y, z = (low[k] + size * (np.arange(shape[k]) + 0.5) for k in range(3))
    distance = np.hypot(x[:, None], y[None])[:, :, None]
    labels = np.full(shape, 17, np.uint8)
    labels[np.broadcast_to((distance < RING_M) & (z < 0), shape)] = 11
    labels[np.broadcast_to((abs(distance - RING_M) < 0.4) & (z > 0) & (z < 3), shape)] = 15
    return labels, np.broadcast_to(distance < RING_M + 2, shape)


def sensors():
    """Return the records of `sensor` and `calibrated_sensor`."""
    kinds, calibrated = [], []
    for channel in (*CAMERAS, LIDAR):
        kinds.append({"token": f"sensor-{channel}", "channel": channel, "modality": "camera"})
        angle_deg = YAWS_DEG.get(channel, -90)
        ahead_m = 0.7 * float(np.cos(np.radians(angle_deg)))
        lidar = channel == LIDAR
        calibrated.append(
            {
                "token": f"calibrated-{channel}",
                "sensor_token": f"sensor-{channel}",
                "translation": [0.94, 0.0, 1.84] if lidar else [0.9 + ahead_m, 0.0, 1.5],
                "rotation": about_z(angle_deg) if lidar else product(about_z(angle_deg), AHEAD),
                "camera_intrinsic": [] if lidar else [[FOCAL_PX, 0.0, 79.5], [0.0, FOCAL_PX, 44.5], [0.0, 0.0, 1.0]],
            }
        )
    return kinds, calibrated


def write_nuscenes(root: Path, scenes=("scene-0001", "scene-0002", "scene-0003"), frames=3, version="v1.0-trainval"):
    """Write tables, images, points and labels; every scene drives along +x of the world at 9 m/s."""
    rng = np.random.default_rng(0)
    rows = {name: [] for name in ("scene", "sample", "sample_data", "ego_pose")}
    rows["sensor"], rows["calibrated_sensor"] = sensors()
    for number, scene in enumerate(scenes):
        rows["scene"].append({"token": f"token-{scene}", "name": scene, "nbr_samples": frames})
        for frame in range(frames):
            time_us = BEGIN_US + 500_000 * frame
            token = f"{scene}-{frame}"
            rows["sample"].append({"token": token, "timestamp": time_us, "scene_token": f"token-{scene}"})
            for channel in (*CAMERAS, LIDAR):
                then_us = time_us if channel == LIDAR else time_us - EARLY_US
                write_capture(root, rows, token, channel, then_us, 50.0 * number, rng)
            write_labels(root / "gts" / scene / token / "labels.npz", rng)
    (root / version).mkdir()
    for name, table in rows.items():
        (root / version / f"{name}.json").write_text(json.dumps(table, indent=0))
    return root


def write_capture(root, rows, token, channel, time_us, y_m, rng):
    """Write an image or a scan, and its records; a sweep of the same sensor comes with it."""
    name = f"{token}__{channel}__{time_us}"
    lidar, extension = channel == LIDAR, "pcd.bin" if channel == LIDAR else "jpg"
    path = root / f"samples/{channel}/{name}.{extension}"
    path.parent.mkdir(parents=True, exist_ok=True)
    if lidar:
        path.write_bytes(wall_points(1.84).tobytes())
    else:
        cv2.imwrite(str(path), cv2.resize(rng.integers(0, 255, (9, 16, 3), dtype=np.uint8), SIZE))
    place_m = [411.0 + SPEED_MPS * 1e-6 * (time_us - BEGIN_US), 1180.0 + y_m, 0.0]
    rows["ego_pose"].append({"token": f"pose-{name}", "rotation": [1.0, 0.0, 0.0, 0.0], "translation": place_m})
    for is_key_frame, suffix in ((True, ""), (False, "-sweep")):
        rows["sample_data"].append(
            {
                "token": f"{name}{suffix}",
                "sample_token": token,
                "ego_pose_token": f"pose-{name}",
                "calibrated_sensor_token": f"calibrated-{channel}",
                "is_key_frame": is_key_frame,
                "filename": str(path.relative_to(root)),
                "fileformat": extension,
                "timestamp": time_us,
                "width": 0 if lidar else SIZE[0],
                "height": 0 if lidar else SIZE[1],
            }
        )


def write_labels(path, rng):
    """Write the labels of one frame with both masks; the camera mask lies inside the LiDAR mask."""
    labels, seen = voxels()
    camera = seen & (rng.random(seen.shape) < 0.9)
    path.parent.mkdir(parents=True)
    masks = {"mask_lidar": seen.astype(np.uint8), "mask_camera": camera.astype(np.uint8)}
    np.savez_compressed(path, semantics=labels, **masks)
