"""Cars: one timetable per lane loop, driven by all of its cars with a delay each.

Traffic keeps right, so the lane loops around a block run with the block to the right and never leave the half streets
that the block owns: loops of different blocks cannot meet. All timetables are multiples of one cycle, so what passes a
place repeats with the cycle, and walkers know when they can cross.
"""

from dataclasses import dataclass

import numpy as np

from omniocc.world import vehicle
from omniocc.world.mesh import Mesh
from omniocc.world.motion import Path, Timetable, close, timetable
from omniocc.world.place import Place
from omniocc.world.road import street_path
from omniocc.world.stock import one, pick

CYCLE_S = 32.0
_MIX = {"sedan": 4.0, "hatchback": 3.0, "suv": 3.0, "van": 1.4, "truck": 0.8, "bus": 0.6, "bicycle": 0.6}
_CLEAR_M = 4.0
_STOP_LINE_M = 7.6  # a stopping car's middle before the end of its side, so that its nose is behind the line
_WHEELBASE_SHARE = 0.6


@dataclass(frozen=True)
class Lane:
    """A lane loop around one block.

    Attributes:
        ring: index of the block.
        from_kerb_m: lane centre.
        path, timetable: in driving direction.
        delay_s: (K,) of each car.
        kind: (K,) index into the fleet.
        cycle_delay_s, cycle_kind: the cars of one cycle, present or not; what the crossings are timed by.
    """

    ring: int
    from_kerb_m: float
    path: Path
    timetable: Timetable
    delay_s: np.ndarray
    kind: np.ndarray
    cycle_delay_s: np.ndarray
    cycle_kind: np.ndarray


@dataclass(frozen=True)
class Fleet:
    """Prototypes of moving vehicles and their sizes (F, 3)."""

    meshes: tuple[Mesh, ...]
    size_m: np.ndarray
    names: tuple[str, ...]


def draw_fleet(rng: np.random.Generator, count: int = 14) -> Fleet:
    """A mix of vehicles, one of each kind at least."""
    names = (*vehicle.KINDS, *(pick(rng, _MIX) for _ in range(count - len(vehicle.KINDS))))
    meshes = tuple(one(rng, "vehicle", name) for name in names)
    return Fleet(meshes, np.array([vehicle.size_m(mesh) for mesh in meshes]), names)


def draw_lanes(place: Place, fleet: Fleet, rng: np.random.Generator) -> list[Lane]:
    """All lane loops with their cars."""
    lanes = []
    for index, ring in enumerate(place.network.rings):
        count = min(place.network.edges[side.edge].lanes for side in ring.sides)
        stops = rng.uniform(size=len(ring.sides)) < 0.35
        for k in range(count):
            offset = place.theme.parking_m + (k + 0.5) * place.theme.lane_width_m
            lanes.append(_lane(place, fleet, index, offset, stops, rng))
    return lanes


def _lane(
    place: Place, fleet: Fleet, index: int, from_kerb_m: float, stops: np.ndarray, rng: np.random.Generator
) -> Lane:
    ring, theme = place.network.rings[index], place.theme
    points = street_path(ring, place.terrain, from_kerb_m)[::-1]
    path, around = close(points), ring.side[::-1]
    reached = np.array([along_at(path, point) for point in points])
    speeds = rng.uniform(*theme.speed_mps, len(ring.sides) + 1)
    even = np.linspace(0, path.length_m, int(path.length_m) + 1)
    free = speeds[around[np.searchsorted(reached, even, side="right").clip(1) - 1]]
    ends = [reached[np.flatnonzero(around == k).max()] - _STOP_LINE_M for k in range(len(ring.sides))]
    table = timetable(path, free, np.array(ends)[stops], float(rng.uniform(1.5, 2.5)), CYCLE_S)
    delay, kind = _platoon(theme.car_headway_s, fleet, table, rng)
    rounds = round(table.period_s / CYCLE_S)
    every_delay = (delay[None] + CYCLE_S * np.arange(rounds)[:, None]).ravel()
    every_kind = np.tile(kind, rounds)
    there = rng.uniform(size=len(every_kind)) < 0.85
    there[0] = True
    return Lane(index, from_kerb_m, path, table, every_delay[there], every_kind[there], delay, kind)


def along_at(path: Path, point: np.ndarray) -> float:
    """Arc length of the path's point nearest to a point (2,) or (3,), seen from above."""
    return float(path.along_m[np.argmin(((path.points_m[:-1, :2] - point[:2]) ** 2).sum(1))])


def _platoon(
    headway_s: float, fleet: Fleet, table: Timetable, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Delays and kinds of the cars of one cycle, close together but never closer than their lengths allow."""
    tried = np.arange(1.5, CYCLE_S / 2, 0.5)
    gap = table.least_gap_m(tried)
    kinds = rng.integers(len(fleet.names), size=max(1, round(CYCLE_S / headway_s)))
    start = float(rng.uniform(0, CYCLE_S))
    delay, chosen = [start], [int(kinds[0])]
    for kind in kinds[1:]:
        need = 0.5 * (fleet.size_m[kind, 0] + fleet.size_m[chosen[-1], 0]) + _CLEAR_M
        wide = np.flatnonzero(gap >= need)
        back = np.flatnonzero(gap >= 0.5 * (fleet.size_m[kind, 0] + fleet.size_m[chosen[0], 0]) + _CLEAR_M)
        if not len(wide) or not len(back):
            continue
        after = float(delay[-1] + tried[wide[0]] + rng.uniform(0, 1.5))
        if start + CYCLE_S - after >= tried[back[0]]:
            delay.append(after)
            chosen.append(int(kind))
    return np.array(delay), np.array(chosen)


def positions(lane: Lane, fleet: Fleet, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) middles on the road and (K, 3) unit headings of a lane's cars, both axles on the path."""
    along = lane.timetable.at(time_s + lane.delay_s)
    half = 0.5 * _WHEELBASE_SHARE * fleet.size_m[lane.kind, 0]
    ends = lane.path.at(np.stack([along + half, along - half]))
    heading = ends[0] - ends[1]
    return ends.mean(0), heading / np.linalg.norm(heading, axis=1, keepdims=True)


def passing(lane: Lane, fleet: Fleet, along_m: float, reach_m: float, time_s: np.ndarray) -> np.ndarray:
    """(T,) whether at these times of the cycle any car of the lane may be within `reach_m` of a point of its path."""
    rounds = CYCLE_S * np.arange(round(lane.timetable.period_s / CYCLE_S))
    when = time_s[:, None, None] + lane.cycle_delay_s[:, None] + rounds
    away = (
        np.mod(lane.timetable.at(when) - along_m + lane.path.length_m / 2, lane.path.length_m) - lane.path.length_m / 2
    )
    return (np.abs(away) < reach_m + 0.5 * fleet.size_m[lane.cycle_kind, 0][:, None]).any((1, 2))
