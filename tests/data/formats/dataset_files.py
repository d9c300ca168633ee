"""Write small datasets in the layouts of WoodScape and CarlaSC."""

import json
from pathlib import Path

import cv2
import numpy as np

FRONT = {
    "extrinsic": {
        "quaternion": [0.5941767906169857, -0.5878843193897473, 0.3873184109007999, -0.3890121040340926],
        "translation": [3.7484, 0.0, 0.66017],
    },
    "intrinsic": {
        "aspect_ratio": 1.0,
        "cx_offset": 3.942,
        "cy_offset": -3.093,
        "height": 966.0,
        "width": 1280.0,
        "k1": 339.749,
        "k2": -31.988,
        "k3": 48.275,
        "k4": -7.201,
        "model": "radial_poly",
        "poly_order": 4,
    },
    "name": "FV",
}
"""Numbers of the calibration that WoodScape's repository shows."""


def write_woodscape(root: Path, images=6) -> Path:
    """Write images whose left half is road (1) and whose right half is vehicles (6); the top row is void."""
    for name in ("rgb_images", "calibration", "semantic_annotations/gtLabels"):
        (root / name).mkdir(parents=True)
    ids = np.zeros((483, 640), np.uint8)
    ids[20:, :320], ids[20:, 320:] = 1, 6
    for number in range(images):
        name = f"{number:05d}_{('FV', 'MVL')[number % 2]}"
        cv2.imwrite(str(root / "rgb_images" / f"{name}.png"), np.repeat(40 * ids[..., None], 3, axis=2))
        cv2.imwrite(str(root / "semantic_annotations" / "gtLabels" / f"{name}.png"), ids)
        (root / "calibration" / f"{name}.json").write_text(json.dumps(FRONT))
    return root


def write_carlasc(root: Path, coordinates="cartesian", frames=3) -> Path:
    """Write one scene a split: road below, a building on the right (Unreal: y > 0), cells behind it unseen."""
    shape = (128, 128, 8)
    tags, counts = np.zeros(shape, "<u4"), np.ones(shape, "<f4")
    tags[..., 0] = 7  # road
    tags[70:90, 80:90, 1:6] = 1  # building
    counts[:, 100:] = 0
    turn = np.linspace(-np.pi, np.pi, 400, endpoint=False)
    points = np.stack([8 * np.cos(turn), 8 * np.sin(turn), np.full_like(turn, -1.8), 0 * turn], 1).astype("<f4")
    for split in ("Train", "Val", "Test"):
        folder = root / coordinates.capitalize() / split / "Town01_Light" / coordinates
        for name in ("evaluation", "velodyne", "labels"):
            (folder / name).mkdir(parents=True)
        params = {"grid_size": list(shape), "num_channels": 25, "coordinates": coordinates}
        (folder / "evaluation" / "params.json").write_text(json.dumps(params))
        poses = [np.c_[np.eye(3), [k, 0.5 * k, 0.0]].ravel() for k in range(frames)]
        (folder / "poses.txt").write_text("\n".join(" ".join(map(str, pose)) for pose in poses))
        for frame in range(frames):
            stem = f"{frame:06d}"
            (folder / "evaluation" / f"{stem}.label").write_bytes(tags.tobytes())
            (folder / "evaluation" / f"{stem}.bin").write_bytes(counts.tobytes())
            (folder / "velodyne" / f"{stem}.bin").write_bytes(points.tobytes())
            (folder / "labels" / f"{stem}.label").write_bytes(np.full(len(points), 7, "<u4").tobytes())
    return root
