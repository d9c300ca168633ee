"""Facts on recorded scenes, in words and figures."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from omniocc import seeding
from omniocc.camera import Pinhole
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Grid
from omniworld.fingerprint import world_code
from omniworld.render.light import Light
from omniworld.render.weather import draw_light, draw_weather
from omniworld.variations.night import NIGHT

LOW_SUN_DEG = 25.0

OTHER_DATASETS = (
    ("SemanticKITTI", True, False, True, False, False, 23201),
    ("Occ3D-nuScenes", True, False, True, False, False, 40000),
    ("CarlaSC", True, False, True, True, False, 43200),
    ("OmniDepth-Occ (paper)", True, True, True, True, True, 57600),
)
"""Table I of the paper: pinhole images, fisheye images, cuboid voxels, polar voxels, 2D semantics and depth, frames."""


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
