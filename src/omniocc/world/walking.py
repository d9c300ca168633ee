"""Walkers: rounds along the sidewalks at constant pace, and to and fro over the zebra crossings when no car comes."""

from dataclasses import dataclass

import numpy as np

from omniocc.world.driving import CYCLE_S, Fleet, Lane, along_at, passing
from omniocc.world.marking import CROSSING_M
from omniocc.world.motion import Path, close
from omniocc.world.network import Side
from omniocc.world.place import Place
from omniocc.world.road import CROWN_M, KERB_M, sidewalk_path
from omniocc.world.street import furniture_m

_LEAST_SPACE_M = 2.5
_WAIT_M = 0.35  # from the kerb
_CAUTION_M = 2.0  # free space wanted along the street on both sides of a walker
_MARGIN_S = 0.6
_TICK_S = 0.1
_CLOCK_S = np.arange(0, CYCLE_S, _TICK_S)


@dataclass(frozen=True)
class Round:
    """Walkers who keep their distance around a block: (K,) places at time 0, one speed."""

    path: Path
    speed_mps: float
    along_m: np.ndarray


@dataclass(frozen=True)
class Crosser:
    """Goes from `start_m` to `end_m` (3,) at `leave_s` of every even cycle, and back at `return_s` of every odd one."""

    start_m: np.ndarray
    end_m: np.ndarray
    leave_s: float
    return_s: float
    duration_s: float
    road_share: float

    def share(self, time_s: float) -> tuple[float, float]:
        """How far over, and the direction of walking (+1, -1, or 0 while waiting)."""
        over = (time_s - self.leave_s) % (2 * CYCLE_S)
        back = (time_s - self.return_s - CYCLE_S) % (2 * CYCLE_S)
        part, direction = (over, 1.0) if over < back else (back, -1.0)
        part = min(part / self.duration_s, 1.0)
        return (part if direction > 0 else 1 - part), (direction if part < 1 else 0.0)


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
        pair, pick, pace, across = (
            halves[arm],
            rng.uniform(),
            float(rng.uniform(1.3, 1.7)),
            float(rng.uniform(-0.8, 0.8)),
        )
        if pick > 0.75 or not all(place.paved[index] for index, _ in pair):
            continue
        crosser = _crosser(place, lanes, fleet, pair, arm, pace, across)
        if crosser is not None:
            crossers.append(crosser)
    return crossers


def _crosser(
    place: Place,
    lanes: list[Lane],
    fleet: Fleet,
    pair: list[tuple[int, Side]],
    arm: tuple[int, bool],
    pace: float,
    across: float,
) -> Crosser | None:
    into = 0.5 * (CROSSING_M[0] + CROSSING_M[1]) + across
    kerbs = []
    for _, side in pair:
        s = side.along_m[-1] - into if side.forward == arm[1] else side.along_m[0] + into
        kerbs.append(np.array([np.interp(s, side.along_m, side.kerb_m[:, k]) for k in (0, 1)]))
    street = float(np.linalg.norm(kerbs[1] - kerbs[0]))
    ahead = (kerbs[1] - kerbs[0]) / street
    length = street + 2 * _WAIT_M
    leave, back = np.zeros(len(_CLOCK_S), bool), np.zeros(len(_CLOCK_S), bool)
    for (index, _), kerb, inward in zip(pair, kerbs, (ahead, -ahead), strict=True):
        for lane in (lane for lane in lanes if lane.ring == index):
            place_m = along_at(lane.path, kerb + lane.from_kerb_m * inward)
            busy = passing(lane, fleet, place_m, _CAUTION_M, _CLOCK_S)
            reached = _WAIT_M + (lane.from_kerb_m if index == pair[0][0] else street - lane.from_kerb_m)
            leave |= _blocked(busy, reached / pace, place.theme.lane_width_m / pace)
            back |= _blocked(busy, (length - reached) / pace, place.theme.lane_width_m / pace)
    if leave.all() or back.all() or pair[0][0] == pair[1][0]:
        return None
    ends = [kerbs[0] - _WAIT_M * ahead, kerbs[1] + _WAIT_M * ahead]
    start, end = (np.append(xy, place.terrain.height(*xy) + KERB_M) for xy in ends)
    leave_s, return_s = (float(_CLOCK_S[np.flatnonzero(~late)[0]]) for late in (leave, back))
    return Crosser(start, end, leave_s, return_s, length / pace, street / length)


def _blocked(busy: np.ndarray, reached_s: float, width_s: float) -> np.ndarray:
    """(T,) start times of the cycle at which the walker, in a lane around `reached_s` later, would meet a car there."""
    first, last = (int(np.floor((reached_s + sign * (0.5 * width_s + _MARGIN_S)) / _TICK_S)) for sign in (-1, 1))
    return np.any([np.roll(busy, -shift) for shift in range(first, last + 1)], axis=0)


def crossing_point(place: Place, crosser: Crosser, share: float) -> np.ndarray:
    """(3,) foot point on the way over: up on the kerbs, otherwise on the crown of the street."""
    xy = crosser.start_m[:2] + share * (crosser.end_m[:2] - crosser.start_m[:2])
    from_middle = abs(2 * share - 1) / crosser.road_share
    lift = KERB_M if from_middle > 1 else CROWN_M * (1 - from_middle)
    return np.append(xy, place.terrain.height(*xy) + lift)
