"""Night: a scene at dusk after the last light of the sky has gone; street lamps, windows and headlights remain."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omniworld.mesh.label import VEHICLE
from omniworld.render.light import LAMP_CELL_M, LAMP_CELLS, Light
from omniworld.render.snapshot import Snapshot
from omniworld.scene import Scene
from omniworld.traffic.traffic import Actor

NIGHT = "night"
"""Name of this weather."""
BASE = "dusk"
"""Weather of the scene that becomes night: it decides lamps, clouds, and the exposure of the cameras."""
CAR_M = 3.0
"""Least length of a vehicle with headlights; bicycles are shorter."""
REACH_M = 40.0
"""Farthest point that headlights light."""
BRIGHTNESS = 0.8
"""Light on the road in front of a car, where 1 is that below a street lamp."""


class NightScene(Scene):
    """A scene at night; it has to be made with the weather `BASE`."""

    def snapshot(self, time_s: float) -> tuple[Snapshot, tuple[Actor, ...]]:
        """Return the world at a time, with the headlights of all cars that drive, the own one included."""
        snapshot, actors = super().snapshot(time_s)
        forward = snapshot.rotation[:, 0].astype(np.float64)
        beams = [(snapshot.origin_m[:2] + 2.3 * forward[:2], forward[:2])]
        beams += [beam for actor in actors if (beam := headlights(actor)) is not None]
        light = snapshot.light
        assert light.pools is not None
        return replace(snapshot, light=replace(night_light(light), pools=with_beams(light.pools, beams))), actors


def night_light(dusk: Light) -> Light:
    """Return the light of the same sky at night: a hundredth of a grey day's; moonlight (`sun`) is less."""
    return replace(
        dusk,
        sun=np.array([0.004, 0.005, 0.007], np.float32),
        zenith=np.array([0.003, 0.004, 0.008], np.float32),
        horizon=np.array([0.010, 0.009, 0.010], np.float32),
        bounce=np.zeros(3, np.float32),
        glow=0.0,
        lamps=1.0,
    )


Beam = tuple[np.ndarray, np.ndarray]
"""Where headlights are, (2,) m, and their direction, (2,), in the world frame."""


def headlights(actor: Actor) -> Beam | None:
    """Return the headlights of an actor; None for people and bicycles."""
    if actor.label != VEHICLE or actor.size_m[0] < CAR_M:
        return None
    forward = actor.world_from_actor[:2, 0]
    return actor.world_from_actor[:2, 3] + 0.5 * actor.size_m[0] * forward, forward


def with_beams(pools: np.ndarray, beams: Sequence[Beam]) -> np.ndarray:
    """Return the light of lamps on the ground (`lamp_pools`) with that of headlights.

    Nothing stands in the way of the light, and it is as bright at every height.
    """
    lit = pools.reshape(LAMP_CELLS, LAMP_CELLS).copy()
    steps = np.arange(-int(REACH_M / LAMP_CELL_M), int(REACH_M / LAMP_CELL_M) + 1)
    for place, direction in beams:
        cells = np.floor(place / LAMP_CELL_M).astype(int)
        x, y = ((cell + steps + 0.5) * LAMP_CELL_M - at for cell, at in zip(cells, place, strict=True))
        rows, columns = (cells[:, None] + steps) % LAMP_CELLS
        ahead = x[:, None] * direction[0] + y * direction[1]
        aside = y * direction[0] - x[:, None] * direction[1]
        window = np.ix_(rows, columns)
        lit[window] = np.maximum(lit[window], beam_strength(ahead, aside))
    return lit.ravel()


def beam_strength(ahead_m: np.ndarray, aside_m: np.ndarray) -> np.ndarray:
    """Return the light of a car's headlights on the road, from the distance ahead of and beside its front, m."""
    width_m = 1.6 + 0.2 * np.maximum(ahead_m, 0)
    far = np.clip((REACH_M - ahead_m) / 15, 0, 1) / (1 + (np.maximum(ahead_m, 0) / 16) ** 2)
    near = np.clip(ahead_m / 5, 0, 1)
    return (BRIGHTNESS * near * far * np.exp(-((aside_m / width_m) ** 2))).astype(np.float32)
