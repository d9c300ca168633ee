"""Write small datasets in the layouts that rivals' code reads: ParkOcc, H3O, QuadOcc, Fisheye3DOD.

No real file of these was at hand: the layouts are those of their readers.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import yaml

FOCAL_PX = 560.0
"""Of lenses with rho = focal length x angle, px per radian."""


def ocam_text(width: int, height: int, focal_px: float) -> str:
    """Return a file of OCamCalib: its inverse polynomial is equidistant, the other one the series of x cot x."""
    f = focal_px
    forward = [-f, 0.0, 1 / (3 * f), 0.0, 1 / (45 * f**3), 0.0, 2 / (945 * f**5)]
    inverse = [f * np.pi / 2, f]
    parts = [
        ("polynomial coefficients for the DIRECT mapping function", [len(forward), *forward]),
        ("polynomial coefficients for the inverse mapping function", [len(inverse), *inverse]),
        ('center: "row" and "column"', [(height - 1) / 2, (width - 1) / 2]),
        ('affine parameters "c", "d", "e"', [1.0, 0.0, 0.0]),
        ('image size: "height" and "width"', [height, width]),
    ]
    return "".join(f"#{title}\n\n{' '.join(map(repr, map(_plain, values)))}\n\n" for title, values in parts)


def _plain(value):
    return int(value) if float(value).is_integer() else float(value)


def turned(yaw_deg: float, place_m: tuple[float, float, float]) -> np.ndarray:
    """Return `a_from_b`, (4, 4), of a frame that is turned about z and shifted."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    pose = np.eye(4)
    pose[:2, :2] = (c, -s), (s, c)
    pose[:3, 3] = place_m
    return pose


PARKOCC_YAW_DEG = {"front": 0.0, "left": 90.0, "right": -90.0, "back": 180.0}
PARKOCC_PLACES_M = {
    "front": (2.0, 0.0, -1.3),
    "left": (0.5, 1.0, -1.0),
    "right": (0.5, -1.0, -1.0),
    "back": (-2.0, 0.0, -1.2),
}


def parkocc_rows() -> np.ndarray:
    """Return rows: road (3) below, a wall (2) 5 m to the left, a car (1) ahead, and a cell that is said to be free."""
    x, y = np.meshgrid(np.arange(60, 140), np.arange(60, 140), indexing="ij")
    road = np.stack([x, y, np.full_like(x, 6), np.full_like(x, 3)], -1).reshape(-1, 4)
    x, z = np.meshgrid(np.arange(60, 140), np.arange(6, 26), indexing="ij")
    wall = np.stack([x, np.full_like(x, 150), z, np.full_like(x, 2)], -1).reshape(-1, 4)
    return np.concatenate([road, wall, [[170, 100, 10, 1]], [[0, 199, 31, 0]]]).astype(np.int32)


def write_parkocc(root: Path, scenes=("8",), frames=(9, 10, 11)) -> Path:
    """Write scenes whose car drives ahead by .5 m a frame; frame 12 has a folder and no pose."""
    for name, yaw_deg in PARKOCC_YAW_DEG.items():
        folder = root / "calib" / name
        folder.mkdir(parents=True)
        (folder / f"calib_results_{name}.txt").write_text(ocam_text(1920, 1080, FOCAL_PX))
        camera_from_lidar = np.linalg.inv(turned(yaw_deg, PARKOCC_PLACES_M[name]))
        (folder / f"results_{name}.csv").write_text("\n".join(",".join(map(str, row)) for row in camera_from_lidar))
    x, z = np.meshgrid(np.linspace(-3.9, 3.9, 40), np.linspace(-1.9, -0.2, 18))
    points = np.stack([x, np.full_like(x, 5.05), z, np.ones_like(x)], -1).reshape(-1, 4).astype("<f4")  # the wall
    for scene in scenes:
        for number in (*frames, 12):
            folder = root / "sequences" / scene / str(number)
            folder.mkdir(parents=True)
            for name in PARKOCC_YAW_DEG:
                cv2.imwrite(str(folder / f"{name}_{number}.jpg"), np.full((1080, 1920, 3), 10 * number, np.uint8))
            np.save(folder / f"occ_{number}.npy", parkocc_rows())
            scans = root / "velodyne" / scene / str(number)
            scans.mkdir(parents=True)
            (scans / f"pc_{number}.bin").write_bytes(points.tobytes())
        poses = {
            number: {"headstamp": 0.1 * number, "matrix": turned(0, (0.5 * number, 0, 0)).ravel().tolist()}
            for number in frames
        }
        (root / "sequences" / f"dataset_sence_{scene}.yaml").write_text(yaml.safe_dump(poses))
    return root


H3O_SIZE = (96, 48)
"""Width and height of the panoramas, px."""


def write_h3o(root: Path, frames=2, fine=True) -> Path:
    """Write sequences in CARLA's axes (y right): road below, a wall at y = +5, things of every tag in a row."""
    lists = {"train": ["sequences/Town01_a"], "val": ["sequences/Town02_a"], "test": ["sequences/Town02_b"]}
    for name in ("homo", "heter"):
        (root / f"splits_{name}.json").parent.mkdir(parents=True, exist_ok=True)
        (root / f"splits_{name}.json").write_text(json.dumps(lists))
    width, height = H3O_SIZE
    image = np.zeros((height, width, 3), np.uint8)
    image[:, width // 2 :] = (0, 0, 200)  # red on the right
    for sequence in (name for names in lists.values() for name in names):
        for folder, shape in (("occupancy_gt", (64, 64, 8)), ("occupancy_gt_128x128x16", (128, 128, 16))):
            (root / sequence / folder).mkdir(parents=True)
            tags = np.zeros(shape, np.uint8)
            per_m = shape[0] / 25.6
            tags[:, :, int(0.7 * per_m)] = 1
            tags[:, int(17.8 * per_m), int(0.7 * per_m) :] = 3
            tags[20 : 20 + 29, 2, 7] = np.arange(29)
            for frame in range(frames):
                np.save(root / sequence / folder / f"{frame:06d}.npy", tags)
        for folder in ("panorama_rgb", "panorama_depth_m"):
            (root / sequence / folder).mkdir()
        for frame in range(frames):
            cv2.imwrite(str(root / sequence / "panorama_rgb" / f"{frame:06d}.png"), image)
            np.save(root / sequence / "panorama_depth_m" / f"{frame:06d}.npy", cube_depth(width, height))
    return root


def cube_depth(width: int, height: int) -> np.ndarray:
    """Return planar depth of a room whose walls are 4 m away: 4 on every face of the cube; sky in the upper rows."""
    depth_m = np.full((height, width), 4.0, np.float32)
    depth_m[:4] = 1000.0
    return depth_m


QUADOCC_FOCAL_PX = 120.0
"""Of the annular lens in a raw image of 480 x 480 px, px per radian."""


def write_quadocc(root: Path, sequences=("a", "b", "c"), frames=6) -> Path:
    """Write sequences with a building ahead, something without label to its left, and empty cells as 255."""
    ids = np.full((64, 64, 8), 255, np.uint8)
    ids[:, :, 0] = 5
    ids[48, 24:40, 1:6] = 8
    ids[48, 40:44, 1:6] = 0
    ids[10:25, 2, 7] = np.arange(15)
    z, y = np.meshgrid(np.linspace(-0.7, 1.1, 10), np.linspace(-3.1, 3.1, 30))
    wall = np.stack([np.full_like(y, 6.6), y, z], -1).reshape(-1, 3)
    points = np.concatenate([wall, np.zeros((7, 3))]).astype("<f4")
    header = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    root.mkdir(parents=True, exist_ok=True)
    (root / "PAL_intrinsic_calib_results.txt").write_text(ocam_text(480, 480, QUADOCC_FOCAL_PX))
    for sequence in sequences:
        folder = root / "sequences" / sequence
        for name in ("images_unfold", "images_raw", "voxel_final", "lidar"):
            (folder / name).mkdir(parents=True)
        for frame in range(frames):
            stem = f"{frame:06d}"
            cv2.imwrite(str(folder / "images_unfold" / f"{stem}.jpg"), np.full((96, 576, 3), 20 * frame, np.uint8))
            cv2.imwrite(str(folder / "images_raw" / f"{stem}.jpg"), np.full((480, 480, 3), 20 * frame, np.uint8))
            np.save(folder / "voxel_final" / f"{stem}.npy", ids)
            (folder / "lidar" / f"{stem}.pcd").write_bytes(header.encode() + points.tobytes())
    return root


FISHEYE3DOD_FOCAL_PX = 200.0
FISHEYE3DOD_SENSORS = {  # yaw in CARLA (clockwise) and place on the car, x forward, y RIGHT, z up
    "semantic_lidar": (0.0, (0.0, 0.0, 2.4)),
    "fisheye_camera_front": (0.0, (2.0, 0.0, 0.8)),
    "fisheye_camera_left": (-90.0, (0.5, -1.0, 1.0)),
    "fisheye_camera_right": (90.0, (0.5, 1.0, 1.0)),
    "fisheye_camera_rear": (180.0, (-2.0, 0.0, 0.9)),
    "nu_rgb_camera_front": (0.0, (1.5, 0.0, 1.5)),
    "nu_rgb_camera_front_left": (-55.0, (1.3, -0.5, 1.5)),
    "nu_rgb_camera_front_right": (55.0, (1.3, 0.5, 1.5)),
    "nu_rgb_camera_rear": (180.0, (0.0, 0.0, 1.5)),
    "nu_rgb_camera_rear_left": (-110.0, (1.0, -0.5, 1.5)),
    "nu_rgb_camera_rear_right": (110.0, (1.0, 0.5, 1.5)),
}
WALL_M = 6.1


def fisheye3dod_points() -> tuple[np.ndarray, np.ndarray]:
    """Return points, y to the left, and tags from 0.9.14 on: road, a wall to the left, a car, the own car, no tag."""
    x, y = np.meshgrid(np.arange(-9, 9, 0.5), np.arange(-5, 5, 0.5))
    road = np.stack([x, y, np.full_like(x, -2.35)], -1).reshape(-1, 3)
    x, z = np.meshgrid(np.arange(-9, 9, 0.25), np.arange(-2, 1, 0.25))
    wall = np.stack([x, np.full_like(x, WALL_M), z], -1).reshape(-1, 3)
    points = np.concatenate([road, wall, [[7.0, -2.0, -1.5], [0.0, 0.0, -0.5], [8.0, 2.0, 1.9]]])
    return points, np.repeat([1, 4, 14, 14, 0], [len(road), len(wall), 1, 1, 1])


def write_fisheye3dod(root: Path, towns=("Town01_Opt", "Town02_Opt", "Town03"), frames=6, floats=False) -> Path:
    """Write a recording a town, whose car heads 30 degrees to the right in CARLA and drives .5 m a frame."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "calib_results.txt").write_text(ocam_text(800, 800, FISHEYE3DOD_FOCAL_PX))
    points, tags = fisheye3dod_points()
    rows = np.zeros((len(points), 6), "<f4")
    rows[:, :3] = points
    rows[:, 5] = tags if floats else tags.astype("<u4").view("<f4")
    for town in towns:
        folder = root / f"train-{town}-ClearNoon-2024_09_23_11_44_45" / "ego0"
        for name, (yaw_deg, (x, y, z)) in FISHEYE3DOD_SENSORS.items():
            (folder / name).mkdir(parents=True)
            lines = []
            for k in range(frames):
                number, along = 26981 + k, x + 0.5 * k
                c, s = np.cos(np.radians(30)), np.sin(np.radians(30))  # left-handed: a turn to the right is positive
                place = (100 + c * along - s * y, 50 + s * along + c * y, z)
                lines.append(
                    f"Data(frame={number}, timestamp={0.1 * k:.6f}, transform=Transform(Location(x={place[0]:.6f}, "
                    f"y={place[1]:.6f}, z={place[2]:.6f}), Rotation(pitch=0.000000, yaw={30 + yaw_deg:.6f}, "
                    "roll=0.000000)))"
                )
                stem = folder / name / f"{number:08d}"
                if name == "semantic_lidar":
                    stem.with_suffix(".bin").write_bytes(rows.tobytes())
                elif k % 5 == 0:
                    size = (720, 1280) if name.startswith("nu_") else (800, 800)
                    cv2.imwrite(str(stem.with_suffix(".png")), np.full((*size, 3), 20 * k, np.uint8))
            (folder / name / "sensor_metadata.txt").write_text("\n".join(lines))
    return root
