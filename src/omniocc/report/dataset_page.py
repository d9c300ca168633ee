"""One web page, without any reference to another file, to browse recorded scenes."""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omniocc.camera import Rig
from omniocc.classes import CLASSES, FREE, PALETTE
from omniocc.data.labels.class_fractions import (
    PUBLISHED_PERCENT,
    count_classes,
    count_voxels,
    occupied_percent,
    spread,
)
from omniocc.data.labels.voxels import vote
from omniocc.data.store.codec import decode_frame, decode_image
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Grid
from omniocc.io import atomic_write
from omniocc.report.dataset_facts import (
    OTHER_DATASETS,
    facts_of,
    frame_at,
    own_row,
    pinhole_twin,
    speed_mps,
    time_of_day,
)
from omniocc.view.bev import bev
from omniocc.view.canvas import fitted
from omniocc.view.sheet import AS_SEEN, NAMES
from omniocc.view.voxels import render_voxels
from omniocc.world import Frame

MAX_FRAMES = 64
MAX_FRAMES_PER_SCENE = 6
CAMERA_PX, PANORAMA_PX, BEV_PX, VOXELS_PX = 400, 1200, 480, (854, 480)
NEAR_M, FAR_M = 1.0, 64.0
SKY, UNMEASURED = (225, 233, 242), (24, 26, 30)
TEMPLATE = Path(__file__).with_suffix(".html")


def save_page(path: Path, scenes: Sequence[SceneReader], geometry: Grid) -> None:
    """Writes the page: some frames of each scene, or of evenly spread scenes if there are many.

    Where a pinhole dataset of the same scenes lies beside this one, its images of the same moments are shown too.

    Args:
        path: the .html file.
        scenes: at least one.
        geometry: grid of the voxels that are drawn and counted.

    Raises:
        DataError: when a scene is damaged or the disk refuses.
    """
    shown = [scenes[at] for at in spread(len(scenes), MAX_FRAMES)]
    per_scene = max(1, min(MAX_FRAMES_PER_SCENE, MAX_FRAMES // len(shown)))
    twins = [pinhole_twin(scene) for scene in shown]
    counts = sum(count_voxels(scene, spread(len(scene), per_scene), geometry) for scene in shown)
    content = {
        "facts": facts_of(scenes, len(shown), geometry),
        "table": [*OTHER_DATASETS, own_row(scenes, twins)],
        "classes": [{"name": row.name, "rgb": row.rgb} for row in CLASSES if row.id != FREE],
        "ours": occupied_percent(np.asarray(counts)),
        "authors": PUBLISHED_PERCENT,
        "sky": SKY,
        "scenes": [_scene(scene, twin, per_scene, geometry) for scene, twin in zip(shown, twins, strict=True)],
    }
    # "</" would end the script element
    plain = json.dumps(content, separators=(",", ":")).replace("</", "<\\/")
    atomic_write(Path(path), TEMPLATE.read_text("utf-8").replace("__CONTENT__", plain).encode())


def _scene(scene: SceneReader, twin: SceneReader | None, per_scene: int, geometry: Grid) -> dict[str, Any]:
    facts = scene.meta["facts"]
    frames = spread(len(scene), per_scene)
    return {
        "name": scene.name,
        "theme": facts["theme"],
        "split": facts["split"],
        "weather": facts["weather"],
        "day": time_of_day(facts),
        "cameras": [_camera_name(scene.rig, k) for k in _order(scene.rig)],
        "pinholes": [_camera_name(twin.rig, k) for k in _order(twin.rig)] if twin else [],
        "frames": [_frame(scene, at, geometry) | _pinholes(twin, float(scene.time_s[at])) for at in frames],
    }


def _camera_name(rig: Rig, camera: int) -> str:
    return NAMES[camera] if len(rig.cameras) == len(NAMES) else rig.names[camera]


def _order(rig: Rig) -> Sequence[int]:
    return AS_SEEN if len(rig.cameras) == len(NAMES) else range(len(rig.cameras))


def _pinholes(twin: SceneReader | None, time_s: float) -> dict[str, Any]:
    number = frame_at(twin, time_s) if twin else None
    if twin is None or number is None:
        return {"pinhole": []}
    blobs = twin.read(number, [f"rgb{k}.jpg" for k in _order(twin.rig)])
    return {"pinhole": [_webp(_smaller(decode_image(blob))) for blob in blobs.values()]}


def _frame(scene: SceneReader, number: int, geometry: Grid) -> dict[str, Any]:
    frame = decode_frame(scene.read(number, scene.index["members"]))
    order = _order(scene.rig)
    voxels = vote(scene, number, geometry)
    percent = occupied_percent(count_classes(voxels.numpy()))
    return {
        "number": number,
        "time": round(frame.time_s, 3),
        "speed": round(speed_mps(scene, number), 1),
        "actors": len(frame.boxes),
        "rgb": [_webp(_smaller(frame.images[k])) for k in order],
        "semantic": [_png(_semantics(frame, k)) for k in order],
        "range": [_webp(range_picture(frame.range_m[k], CAMERA_PX)) for k in order],
        "panorama": _webp(range_picture(frame.erp_range_m, PANORAMA_PX)),
        "bev": _png(bev(voxels, geometry, BEV_PX)),
        "voxels": _webp(render_voxels(voxels, geometry, *VOXELS_PX)),
        "percent": [round(value, 2) for value in percent.values()],
    }


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


def _webp(picture: np.ndarray) -> str:
    return _inline(".webp", "image/webp", picture, [cv2.IMWRITE_WEBP_QUALITY, 80])


def _png(picture: np.ndarray) -> str:
    return _inline(".png", "image/png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _inline(kind: str, mime: str, picture: np.ndarray, options: list[int]) -> str:
    done, data = cv2.imencode(kind, cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2BGR), options)
    assert done
    return f"data:{mime};base64,{base64.b64encode(data.tobytes()).decode()}"
