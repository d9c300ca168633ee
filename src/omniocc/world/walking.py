"""Walkers: rounds along the sidewalks at constant pace, and to and fro over the zebra crossings when no car comes."""

from dataclasses import dataclass

import numpy as np

from omniocc.world.driving import CYCLE_S, Fleet, Lane, passing
from omniocc.world.marking import CROSSING_M
from omniocc.world.motion import Path, close
from omniocc.world.network import Side
from omniocc.world.place import Place
from omniocc.world.road import CROWN_M, KERB_M, sidewalk_path
from omniocc.world.street import furniture_m

_LEAST_SPACE_M = 2.5
_WAIT_M = 0.35  # from the kerb
_CAUTION_M = 4.0  # free space wanted along the street on both sides of a crossing's middle


@dataclass(frozen=True)
class Round:
    """Walkers who keep their distance around a block: (K,) places at time 0, one speed."""

    path: Path
    speed_mps: float
    along_m: np.ndarray


@dataclass(frozen=True)
class Crosser:
    """Goes over from `start_m` to `end_m` (3,) at `leave_s` of every even cycle, and back in every odd one."""

    start_m: np.ndarray
    end_m: np.ndarray
    leave_s: float
    duration_s: float
    road_share: float

    def share(self, time_s: float) -> tuple[float, float]:
        """How far over, and the direction of walking (+1, -1, or 0 while waiting)."""
        since = (time_s - self.leave_s) % (2 * CYCLE_S)
        back = since >= CYCLE_S
        part = min((since - CYCLE_S * back) / self.duration_s, 1.0)
        return (1 - part, -1.0 if part < 1 else 0.0) if back else (part, 1.0 if part < 1 else 0.0)


def draw_rounds(place: Place, rng: np.random.Generator) -> list[Round]:
    """Two files of walkers around every block with a sidewalk, in opposite directions."""
    rounds = []
    strip, wide = furniture_m(place.theme), place.theme.sidewalk_m
    for ring, paved in zip(place.network.rings, place.paved, strict=True):
        for offset, forward in ((strip + 0.35, False), (wide - 0.32, True)):
            if not paved:
                continue
            points = sidewalk_path(ring, place.terrain, offset)
            path = close(points if forward else points[::-1])
            scale = path.length_m / 340 / 2
            count = min(rng.poisson(place.theme.walkers_per_block * scale), int(path.length_m / _LEAST_SPACE_M / 2))
            slots = (np.arange(count) + rng.uniform(0, 0.5, count)) * path.length_m / max(count, 1)
            rounds.append(Round(path, float(rng.uniform(1.1, 1.6)), slots))
    return rounds


def draw_crossers(place: Place, lanes: list[Lane], fleet: Fleet, rng: np.random.Generator) -> list[Crosser]:
    """At most one per zebra crossing, where the traffic leaves a gap that is long enough."""
    halves: dict[tuple[int, bool], list[tuple[int, Side]]] = {}
    for index, ring in enumerate(place.network.rings):
        for side in ring.sides:
            for end in (False, True):
                halves.setdefault((side.edge, end), []).append((index, side))
    crossers = []
    for arm in sorted(place.crossings):
        pair, pick, pace, across = halves[arm], rng.uniform(), float(rng.uniform(1.3, 1.7)), float(rng.uniform(-0.8, 0.8))
        if pick > 0.6 or not all(place.paved[index] for index, _ in pair):
            continue
        crosser = _crosser(place, lanes, fleet, pair, arm, pace, across)
        if crosser is not None:
            crossers.append(crosser)
    return crossers


def _crosser(
    place: Place, lanes: list[Lane], fleet: Fleet, pair: list[tuple[int, Side]], arm: tuple[int, bool], pace: float, across: float
) -> Crosser | None:
    time = np.arange(0, CYCLE_S, 0.1)
    busy = np.zeros(len(time), bool)
    feet = []
    for index, side in pair:
        into = 0.5 * (CROSSING_M[0] + CROSSING_M[1]) + across
        at_end = side.forward == arm[1]
        s = side.along_m[-1] - into if at_end else side.along_m[0] + into
        kerb, center = (np.array([np.interp(s, side.along_m, p[:, k]) for k in (0, 1)]) for p in (side.kerb_m, side.center_m))
        outward = (kerb - center) / np.linalg.norm(kerb - center)
        feet.append(kerb + _WAIT_M * outward)
        for lane in lanes:
            if lane.ring == index:
                on_lane = kerb - lane.from_kerb_m * outward
                nearest = int(np.argmin(np.linalg.norm(lane.path.points_m[:, :2] - on_lane, axis=1)))
                busy |= passing(lane, fleet, float(lane.path.along_m[nearest]), _CAUTION_M, time)
    length = float(np.linalg.norm(feet[1] - feet[0]))
    need = int((length / pace + 0.6) / 0.1)
    free = [k for k in range(len(time)) if not np.take(busy, np.arange(k, k + need), mode="wrap").any()]
    if not free:
        return None
    ends = [np.append(xy, place.terrain.height(*xy) + KERB_M) for xy in feet]
    return Crosser(ends[0], ends[1], float(time[free[0]]) + 0.3, length / pace, 1 - 2 * _WAIT_M / length)


def crossing_point(place: Place, crosser: Crosser, share: float) -> np.ndarray:
    """(3,) foot point on the way over: up on the kerbs, otherwise on the crown of the street."""
    xy = crosser.start_m[:2] + share * (crosser.end_m[:2] - crosser.start_m[:2])
    from_middle = abs(2 * share - 1) / crosser.road_share
    lift = KERB_M if from_middle > 1 else CROWN_M * (1 - from_middle)
    return np.append(xy, place.terrain.height(*xy) + lift)
