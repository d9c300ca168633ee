"""One web page, without any reference to another file, to browse recorded scenes."""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omniocc.camera import Pinhole, Rig
from omniocc.classes import CLASSES, FREE, PALETTE
from omniocc.data.codec import decode_frame
from omniocc.data.errors import write_whole
from omniocc.data.reader import SceneReader
from omniocc.data.shares import count_voxels, occupied_percent, spread
from omniocc.data.voxels import vote
from omniocc.geometry import Grid
from omniocc.view.bev import bev
from omniocc.view.canvas import fitted
from omniocc.view.compare import AS_SEEN, NAMES
from omniocc.view.voxels import render_voxels
from omniocc.world import Frame
from omniocc.world.shares import AUTHORS_SHARES

MAX_FRAMES = 64
MAX_FRAMES_PER_SCENE = 6
CAMERA_PX, PANORAMA_PX, BEV_PX, VOXELS_PX = 400, 1200, 480, (854, 480)
NEAR_M, FAR_M = 1.0, 64.0
SKY, UNMEASURED = (225, 233, 242), (24, 26, 30)
TEMPLATE = Path(__file__).with_suffix(".html")

OTHER_DATASETS = (
    ("SemanticKITTI", True, False, True, False, False, 23201),
    ("Occ3D-nuScenes", True, False, True, False, False, 40000),
    ("CarlaSC", True, False, True, True, False, 43200),
    ("OmniDepth-Occ (paper)", True, True, True, True, True, 57600),
)
"""Table I of the paper: pinhole images, fisheye images, cuboid voxels, polar voxels, 2D semantics and depth, frames."""


def save_page(path: Path, scenes: Sequence[SceneReader], geometry: Grid) -> None:
    """Writes the page: some frames of each scene, or of evenly spread scenes if there are many.

    Args:
        path: the .html file.
        scenes: at least one.
        geometry: grid of the voxels that are drawn and counted.

    Raises:
        DataError: when a scene is damaged or the disk refuses.
    """
    shown = [scenes[at] for at in spread(len(scenes), MAX_FRAMES)]
    per_scene = max(1, min(MAX_FRAMES_PER_SCENE, MAX_FRAMES // len(shown)))
    counts = sum(count_voxels(scene, spread(len(scene), per_scene), geometry) for scene in shown)
    content = {
        "facts": _facts(scenes, len(shown), geometry),
        "table": [*OTHER_DATASETS, _own_row(scenes)],
        "classes": [{"name": row.name, "rgb": row.rgb} for row in CLASSES if row.id != FREE],
        "ours": occupied_percent(np.asarray(counts)),
        "authors": AUTHORS_SHARES,
        "scenes": [_scene(scene, per_scene, geometry) for scene in shown],
    }
    # "</" would end the script element
    plain = json.dumps(content, separators=(",", ":")).replace("</", "<\\/")
    write_whole(Path(path), TEMPLATE.read_text("utf-8").replace("__CONTENT__", plain).encode())


def _facts(scenes: Sequence[SceneReader], shown: int, geometry: Grid) -> dict[str, str]:
    first = scenes[0]
    rig = first.rig
    frames = sum(map(len, scenes))
    size = sum(facts["size"] for scene in scenes for facts in scene.meta["files"].values())
    step_s = float(np.diff(first.time_s).mean()) if len(first) > 1 else 0.0
    return {
        "Scenes": f"{len(scenes)}" + (f", {shown} shown" if shown < len(scenes) else ""),
        "Frames": f"{frames:,}" + (f", one each {step_s:g} s" if step_s else ""),
        "Places": str(len({scene.meta["facts"]["theme"] for scene in scenes})),
        "Cameras": f"{len(rig.cameras)} of {rig.cameras[0].width} x {rig.cameras[0].height} px",
        "Size": f"{size / 1e9:.2f} GB, {size / 1e6 / frames:.2f} MB a frame",
        "Voxels drawn": f"{type(geometry).__name__} {' x '.join(map(str, geometry.shape))}",
    }


def _own_row(scenes: Sequence[SceneReader]) -> tuple[Any, ...]:
    pinhole = any(isinstance(camera, Pinhole) for scene in scenes for camera in scene.rig.cameras)
    fisheye = any(not isinstance(camera, Pinhole) for scene in scenes for camera in scene.rig.cameras)
    # any grid can be voted from the points of any scene
    return ("This dataset", pinhole, fisheye, True, True, True, sum(map(len, scenes)))


def _scene(scene: SceneReader, per_scene: int, geometry: Grid) -> dict[str, Any]:
    facts = scene.meta["facts"]
    order = AS_SEEN if len(scene.rig.cameras) == len(NAMES) else range(len(scene.rig.cameras))
    return {
        "name": scene.name,
        "theme": facts["theme"],
        "split": facts["split"],
        "cameras": [_camera_name(scene.rig, k) for k in order],
        "frames": [_frame(scene, at, list(order), geometry) for at in spread(len(scene), per_scene)],
    }


def _camera_name(rig: Rig, camera: int) -> str:
    return NAMES[camera] if len(rig.cameras) == len(NAMES) else rig.names[camera]


def _frame(scene: SceneReader, number: int, order: list[int], geometry: Grid) -> dict[str, Any]:
    frame = decode_frame(scene.read(number, scene.index["members"]))
    voxels = vote(scene, number, geometry)
    shares = occupied_percent(np.bincount(voxels.numpy().ravel(), minlength=256)[: len(CLASSES)])
    return {
        "number": number,
        "time": round(frame.time_s, 3),
        "speed": round(_speed_mps(scene, number), 1),
        "actors": len(frame.boxes),
        "rgb": [_jpeg(_smaller(frame.images[k]), 82) for k in order],
        "semantic": [_png(_semantics(frame, k)) for k in order],
        "range": [_jpeg(range_picture(frame.range_m[k], CAMERA_PX), 82) for k in order],
        "panorama": _jpeg(range_picture(frame.erp_range_m, PANORAMA_PX), 82),
        "bev": _png(bev(voxels, geometry, BEV_PX)),
        "voxels": _jpeg(render_voxels(voxels, geometry, *VOXELS_PX), 85),
        "shares": [round(share, 2) for share in shares.values()],
    }


def _speed_mps(scene: SceneReader, frame: int) -> float:
    if len(scene) < 2:
        return 0.0
    first = min(frame, len(scene) - 2)
    moved = scene.world_from_ego[first + 1, :3, 3] - scene.world_from_ego[first, :3, 3]
    return float(np.linalg.norm(moved) / (scene.time_s[first + 1] - scene.time_s[first]))


def range_picture(range_m: np.ndarray, width: int) -> np.ndarray:
    """(H, W) metres as colours: the logarithm from 1 m (red) to 64 m (blue); sky pale, no measurement dark."""
    finite = np.isfinite(range_m)
    level = np.log(np.where(finite, range_m, FAR_M).clip(NEAR_M, FAR_M) / NEAR_M) / np.log(FAR_M / NEAR_M)
    picture = cv2.applyColorMap((245 - 230 * level).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1].copy()
    picture[np.isposinf(range_m)] = SKY
    picture[np.isnan(range_m)] = UNMEASURED
    height = round(range_m.shape[0] * width / range_m.shape[1])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_NEAREST)


def _semantics(frame: Frame, camera: int) -> np.ndarray:
    labels = frame.semantics[camera]
    colors = PALETTE[labels]
    colors[labels == FREE] = SKY
    width = min(CAMERA_PX, labels.shape[1])
    size = (width, round(labels.shape[0] * width / labels.shape[1]))
    return cv2.resize(colors, size, interpolation=cv2.INTER_NEAREST)


def _smaller(image: np.ndarray) -> np.ndarray:
    return fitted(image, CAMERA_PX) if image.shape[1] > CAMERA_PX else image


def _jpeg(picture: np.ndarray, quality: int) -> str:
    return _inline(".jpg", "image/jpeg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])


def _png(picture: np.ndarray) -> str:
    return _inline(".png", "image/png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _inline(kind: str, mime: str, picture: np.ndarray, options: list[int]) -> str:
    done, data = cv2.imencode(kind, cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2BGR), options)
    assert done
    return f"data:{mime};base64,{base64.b64encode(data.tobytes()).decode()}"
