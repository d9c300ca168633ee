"""A web page in a single file to browse recorded scenes: `templates/dataset.html.j2`, and facts on them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omniocc import seeding
from omniocc.camera import Pinhole, Rig
from omniocc.classes import FREE, ClassTable
from omniocc.data.labels.voxels import vote
from omniocc.data.spacing import evenly_spaced
from omniocc.data.store.codec import POINTS, decode_frame, decode_image
from omniocc.data.store.reader import SceneReader
from omniocc.draw.bev import bev
from omniocc.draw.canvas import fitted
from omniocc.draw.ranges import SKY, range_colors
from omniocc.draw.sheet import HEXAGON_ORDER, NAMES
from omniocc.draw.voxels import render_voxels
from omniocc.extras.viewer.collect import show_scenes, with_progress
from omniocc.extras.viewer.page import write_page
from omniocc.extras.viewer.scenes import scenes_of
from omniocc.geometry import Grid
from omniocc.io import atomic_write
from omniocc.progress import Progress
from omniocc.report.datasets import own_row
from omniocc.report.html import png, render, webp
from omniocc.runs.folder import PAGE
from omniworld.class_fractions import PUBLISHED_PERCENT, count_voxels, occupied_percent
from omniworld.fingerprint import world_code
from omniworld.render.light import Light
from omniworld.render.weather import draw_light, draw_weather
from omniworld.variations.night import NIGHT

MAX_FRAMES = 64
MAX_FRAMES_PER_SCENE = 6
CAMERA_PX, PANORAMA_PX, BEV_PX, VOXELS_PX = 400, 1200, 480, (854, 480)
UNMEASURED = (24, 26, 30)
WEBP_QUALITY = 80
LOW_SUN_DEG = 25.0
OTHER_DATASETS = (
    ("SemanticKITTI", True, False, True, False, False, 23201),
    ("Occ3D-nuScenes", True, False, True, False, False, 40000),
    ("CarlaSC", True, False, True, True, False, 43200),
    ("OmniDepth-Occ (paper)", True, True, True, True, True, 57600),
)
"""Table I of the paper: pinhole images, fisheye images, cuboid voxels, polar voxels, 2D semantics and depth, frames."""


def save_page(path: Path, scenes: Sequence[SceneReader], geometry: Grid, classes: ClassTable) -> None:
    """Write the page: some frames of each scene, or of evenly spread scenes if there are many.

    Voxels are drawn and counted on the grid `geometry`, and can be turned in another page beside it, `view.html`. If a
    pinhole dataset of the same scenes is beside this one, its images at the same times are shown too. There must be at
    least one scene.

    Raises:
        DataError: when a scene is damaged or the disk refuses.
    """
    shown = [scenes[at] for at in evenly_spaced(len(scenes), MAX_FRAMES)]
    per_scene = max(1, min(MAX_FRAMES_PER_SCENE, MAX_FRAMES // len(shown)))
    twins = [pinhole_twin(scene) for scene in shown]
    counts, drawn = [], []
    with Progress("page", len(shown), "scenes") as progress:
        for scene, twin in zip(shown, twins, strict=True):
            counted = evenly_spaced(len(scene), per_scene) if scene.has(POINTS) else []
            counts.append(count_voxels(scene, counted, geometry))
            drawn.append(_scene(scene, twin, per_scene, geometry, classes))
            progress.advance()
    content = {
        "facts": facts_of(scenes, len(shown), geometry),
        "table": [*OTHER_DATASETS, own_row(scenes, twins)],
        "classes": [{"name": row.name, "rgb": row.rgb} for row in classes.rows if row.id != FREE],
        "ours": occupied_percent(np.sum(counts, axis=0)),
        "authors": PUBLISHED_PERCENT,
        "sky": SKY,
        "scenes": drawn,
        "viewer": PAGE,
    }
    atomic_write(path, render("dataset.html.j2", {"content": content}))
    frames = [(scene, evenly_spaced(len(scene), per_scene)) for scene in shown]
    turned = show_scenes(scenes_of(frames, path.parent), (), (geometry,))
    write_page(turned, with_progress(turned), path.with_name(PAGE), CAMERA_PX)


def _scene(
    scene: SceneReader, twin: SceneReader | None, per_scene: int, geometry: Grid, classes: ClassTable
) -> dict[str, Any]:
    facts = scene.meta["facts"]
    frames = evenly_spaced(len(scene), per_scene)
    return {
        "name": scene.name,
        "theme": facts["theme"],
        "split": facts["split"],
        "weather": facts["weather"],
        "day": time_of_day(facts),
        "cameras": [_camera_name(scene.rig, k) for k in _order(scene.rig)],
        "pinholes": [_camera_name(twin.rig, k) for k in _order(twin.rig)] if twin else [],
        "frames": [_frame(scene, at, geometry, classes) | _pinholes(twin, float(scene.time_s[at])) for at in frames],
    }


def _camera_name(rig: Rig, camera: int) -> str:
    return NAMES[camera] if len(rig.cameras) == len(NAMES) else rig.names[camera]


def _order(rig: Rig) -> Sequence[int]:
    return HEXAGON_ORDER if len(rig.cameras) == len(NAMES) else range(len(rig.cameras))


def _pinholes(twin: SceneReader | None, time_s: float) -> dict[str, Any]:
    number = frame_at(twin, time_s) if twin else None
    if twin is None or number is None:
        return {"pinhole": []}
    blobs = twin.read(number, [f"rgb{k}.jpg" for k in _order(twin.rig)])
    return {"pinhole": [webp(_smaller(decode_image(blob)), WEBP_QUALITY) for blob in blobs.values()]}


def _frame(scene: SceneReader, number: int, geometry: Grid, classes: ClassTable) -> dict[str, Any]:
    frame = decode_frame(scene.read(number, scene.index.members))
    order, palette = _order(scene.rig), classes.palette
    return {
        "number": number,
        "time": round(frame.time_s, 3),
        "speed": round(speed_mps(scene, number), 1),
        "actors": len(frame.boxes),
        "rgb": [webp(_smaller(frame.images[k]), WEBP_QUALITY) for k in order],
        "semantic": [] if frame.semantics is None else [png(_semantics(frame.semantics[k], palette)) for k in order],
        "range": [] if frame.range_m is None else [_range(frame.range_m[k], CAMERA_PX) for k in order],
        "panorama": "" if frame.erp_range_m is None else _range(frame.erp_range_m, PANORAMA_PX),
        **_voxels(scene, number, geometry, classes),
    }


def _voxels(scene: SceneReader, number: int, geometry: Grid, classes: ClassTable) -> dict[str, Any]:
    if not scene.has(POINTS):
        return {"bev": "", "voxels": "", "percent": [0.0] * (classes.num_classes - 1)}
    voxels = vote(scene, number, geometry)
    percent = occupied_percent(np.bincount(voxels.numpy().ravel(), minlength=256)[: classes.num_classes])
    return {
        "bev": png(bev(voxels, geometry, classes, BEV_PX)),
        "voxels": webp(render_voxels(voxels, geometry, classes, *VOXELS_PX), WEBP_QUALITY),
        "percent": [round(value, 2) for value in percent.values()],
    }


def _range(range_m: np.ndarray, width: int) -> str:
    return webp(range_image(range_m, width), WEBP_QUALITY)


def range_image(range_m: np.ndarray, width: int) -> np.ndarray:
    """Return an RGB image, `width` px wide, of ranges (H, W) in m; inf is sky, nan was not measured.

    Colours follow the logarithm from 1 m (red) to 64 m (blue); sky is pale, no measurement dark.
    """
    image = range_colors(range_m)
    image[np.isnan(range_m)] = UNMEASURED
    return fitted(image, width, cv2.INTER_NEAREST)


def _semantics(labels: np.ndarray, palette: np.ndarray) -> np.ndarray:
    colors = palette[labels]
    colors[labels == FREE] = SKY
    return fitted(colors, min(CAMERA_PX, labels.shape[1]), cv2.INTER_NEAREST)


def _smaller(image: np.ndarray) -> np.ndarray:
    return fitted(image, CAMERA_PX) if image.shape[1] > CAMERA_PX else image


def facts_of(scenes: Sequence[SceneReader], shown: int, geometry: Grid) -> dict[str, str]:
    """Return facts about amount and recording of the data by title; `shown` scenes are on the page."""
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


def pinhole_twin(scene: SceneReader) -> SceneReader | None:
    """Return the same scene recorded by pinhole cameras, if such a dataset is beside the scene's own.

    It has the same street, traffic and light: equal name, theme, seed, weather and code of the world.
    """
    if isinstance(scene.folder, str) or _is_pinhole(scene):
        return None
    for folder in sorted(scene.folder.parent.parent.glob(f"virtual-*/{scene.name}")):
        other = SceneReader(folder)
        if _is_pinhole(other) and _drawn(other) == _drawn(scene):
            return other
    return None


def frame_at(scene: SceneReader, time_s: float) -> int | None:
    """Return the number of the frame recorded at this time; None if there is none."""
    at = int(np.abs(scene.time_s - time_s).argmin())
    return at if abs(scene.time_s[at] - time_s) < 1e-6 else None


def speed_mps(scene: SceneReader, frame: int) -> float:
    """Return the speed between a frame and the next, m/s."""
    if len(scene) < 2:
        return 0.0
    first = min(frame, len(scene) - 2)
    moved = scene.world_from_ego[first + 1, :3, 3] - scene.world_from_ego[first, :3, 3]
    return float(np.linalg.norm(moved) / (scene.time_s[first + 1] - scene.time_s[first]))


def light_of(theme: str, seed: int, weather: str) -> Light:
    """Return sun, sky and air as `omniworld.Scene` draws them for a scene."""
    rng = seeding.generator(theme, seed, "light")
    draw_weather(rng)
    return draw_light(weather, rng)


def time_of_day(facts: dict[str, Any]) -> str:
    """Return the time of day in words, with the sun's elevation; empty for scenes of another version of the world."""
    if facts["recipe"]["world"] != world_code():
        return ""
    if facts["weather"] == NIGHT:
        return NIGHT
    light = light_of(facts["theme"], facts["seed"], facts["weather"])
    if not light.sun.any():
        return "day, sun hidden"
    elevation_deg = float(np.degrees(np.arcsin(light.sun_direction[2])))
    when = "dusk" if light.lamps else "morning or evening" if elevation_deg < LOW_SUN_DEG else "day"
    return f"{when}, sun {elevation_deg:.0f}° high"


def _is_pinhole(scene: SceneReader) -> bool:
    return all(isinstance(camera, Pinhole) for camera in scene.rig.cameras)


def _drawn(scene: SceneReader) -> tuple[Any, ...]:
    facts = scene.meta["facts"]
    return (facts["theme"], facts["seed"], facts["weather"], facts["recipe"]["world"])
