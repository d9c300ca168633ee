"""Write a small dataset in the layout of nuScenes and Occ3D: tables, images, LiDAR points, labels."""

import json
from pathlib import Path

import cv2
import numpy as np

from omniocc.data.formats.nuscenes import CAMERAS, LIDAR

SIZE = (160, 90)
"""Width and height of the images, px, a tenth of nuScenes'."""
FOCAL_PX = 126.6
HALF = 0.5**0.5
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
        w * v - x * p - y * q - z * r, w * p + x * v + y * r - z * q,
        w * q - x * r + y * v + z * p, w * r + x * q - y * p + z * v,
    ]  # fmt: skip


def about_z(angle_deg):
    half = np.radians(angle_deg) / 2
    return [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]


def wall_points(sensor_z_m):
    """Points of road and round wall in the LiDAR's frame: x right, y forward, z up from the sensor."""
    turn = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    wall = [
        np.stack([RING_M * np.sin(turn), RING_M * np.cos(turn), np.full_like(turn, z)], 1) for z in (-1.0, 0.0, 1.0)
    ]
    road = [
        np.stack([r * np.sin(turn), r * np.cos(turn), np.full_like(turn, -sensor_z_m)], 1) for r in (4.0, 7.0, 10.0)
    ]
    points = np.concatenate([*wall, *road, [[0.1, 0.2, 0.0]]])  # the last is on the own car
    return np.concatenate([points, np.zeros((len(points), 2))], 1).astype("<f4")


def voxels(shape=(200, 200, 16), low=(-40.0, -40.0, -1.0), size=0.4):
    """Labels as in the files: driveable surface below, manmade walls around the ego origin, free (17) elsewhere."""
    x, y, z = (low[k] + size * (np.arange(shape[k]) + 0.5) for k in range(3))
    distance = np.hypot(x[:, None], y[None])[:, :, None]
    labels = np.full(shape, 17, np.uint8)
    labels[np.broadcast_to((distance < RING_M) & (z < 0)[None, None], shape)] = 11
    wall = (abs(distance - RING_M) < 0.4) & (z > 0)[None, None] & (z < 3)[None, None]
    labels[np.broadcast_to(wall, shape)] = 15
    return labels, (distance < RING_M + 2) & np.ones(shape, bool)


def write_nuscenes(root: Path, scenes=("scene-0001", "scene-0002", "scene-0003"), frames=3, version="v1.0-trainval"):
    """Write tables, images, points and labels; every scene drives along +x of the world at 9 m/s."""
    rng = np.random.default_rng(0)
    rows = {name: [] for name in ("scene", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose", "log")}
    for channel in (*CAMERAS, LIDAR):
        rows["sensor"].append({"token": f"sensor-{channel}", "channel": channel, "modality": "camera"})
        turned = about_z(YAWS_DEG[channel]) if channel in YAWS_DEG else [HALF, 0.0, 0.0, -HALF]
        place = (
            [0.94, 0.0, 1.84]
            if channel == LIDAR
            else [0.9 + 0.7 * float(np.cos(np.radians(YAWS_DEG[channel]))), 0.0, 1.5]
        )
        k = [[FOCAL_PX, 0.0, 79.5], [0.0, FOCAL_PX, 44.5], [0.0, 0.0, 1.0]]
        rows["calibrated_sensor"].append({
            "token": f"calibrated-{channel}", "sensor_token": f"sensor-{channel}", "translation": place,
            "rotation": product(turned, AHEAD) if channel in YAWS_DEG else turned,
            "camera_intrinsic": [] if channel == LIDAR else k,
        })  # fmt: skip
    labels, seen = voxels()
    for number, scene in enumerate(scenes):
        rows["scene"].append({"token": f"token-{scene}", "name": scene, "nbr_samples": frames})
        for frame in range(frames):
            token, time_us = f"{scene}-{frame}", 1_532_402_927_000_000 + 500_000 * frame
            sample = {"token": token, "timestamp": time_us, "scene_token": f"token-{scene}"}
            rows["sample"].append(sample)
            for channel in (*CAMERAS, LIDAR):
                late_us = 0 if channel == LIDAR else -40_000
                name = f"{scene}__{channel}__{time_us + late_us}"
                extension = "pcd.bin" if channel == LIDAR else "jpg"
                pose = [411.0 + 9e-6 * (time_us + late_us - 1_532_402_927_000_000), 1180.0 + 50 * number, 0.0]
                rows["ego_pose"].append(
                    {
                        "token": f"pose-{name}",
                        "rotation": [1.0, 0.0, 0.0, 0.0],
                        "translation": pose,
                        "timestamp": time_us + late_us,
                    }
                )
                for key, suffix in ((True, ""), (False, "-sweep")):
                    rows["sample_data"].append({
                        "token": f"{name}{suffix}", "sample_token": token, "ego_pose_token": f"pose-{name}",
                        "calibrated_sensor_token": f"calibrated-{channel}", "is_key_frame": key,
                        "filename": f"samples/{channel}/{name}.{extension}", "fileformat": extension,
                        "width": 0 if channel == LIDAR else SIZE[0], "height": 0 if channel == LIDAR else SIZE[1],
                        "timestamp": time_us + late_us, "prev": "", "next": "",
                    })  # fmt: skip
                path = root / f"samples/{channel}/{name}.{extension}"
                path.parent.mkdir(parents=True, exist_ok=True)
                if channel == LIDAR:
                    path.write_bytes(wall_points(1.84).tobytes())
                else:
                    noise = rng.integers(0, 255, (SIZE[1] // 10, SIZE[0] // 10, 3), dtype=np.uint8)
                    cv2.imwrite(str(path), cv2.resize(noise, SIZE))
            path = root / "gts" / scene / token / "labels.npz"
            path.parent.mkdir(parents=True)
            masks = {
                "mask_lidar": seen.astype(np.uint8),
                "mask_camera": (seen & (rng.random(seen.shape) < 0.9)).astype(np.uint8),
            }
            np.savez_compressed(path, semantics=labels, **masks)
    (root / version).mkdir()
    for name, table in rows.items():
        (root / version / f"{name}.json").write_text(json.dumps(table, indent=0))
    return root
