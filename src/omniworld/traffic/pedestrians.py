"""People: walkers around the blocks at constant speed, and people who cross streets."""

from dataclasses import dataclass

import numpy as np

from omniworld.town.line import interpolate
from omniworld.town.marking import CROSSING_M
from omniworld.town.network import Side
from omniworld.town.place import Place
from omniworld.town.road import CROWN_M, KERB_M
from omniworld.town.street import furniture_m
from omniworld.traffic.flow import Crosser
from omniworld.traffic.path import Path, close

_LEAST_SPACE_M = 2.5
_WAIT_M = 0.35  # distance from the kerb while waiting
_ACROSS_M = 0.8  # of each person from the middle of a crossing


@dataclass(frozen=True)
class Round:
    """Walkers on one closed path around a block: (K,) arc lengths at time 0, one speed for all."""

    path: Path
    speed_mps: float
    along_m: np.ndarray


def draw_rounds(place: Place, rng: np.random.Generator) -> list[Round]:
    """Draw two files of walkers around every block with a sidewalk, in opposite directions."""
    rounds = []
    strip, wide = furniture_m(place.theme), place.theme.sidewalk_m
    for ring, paved in zip(place.network.rings, place.paved, strict=True):
        files = ((strip + 0.35, False), (wide - 0.32, True)) if wide - strip > 1.3 else ((0.5 * (strip + wide), True),)
        for offset, forward in files:
            if not paved:
                continue
            points = place.terrain.points(ring.offset(offset), KERB_M)
            path = close(points if forward else points[::-1])
            scale = path.length_m / 340 / len(files)
            count = min(rng.poisson(place.theme.walkers_per_block * scale), int(path.length_m / _LEAST_SPACE_M / 2))
            slots = (np.arange(count) + rng.uniform(0, 0.5, count)) * path.length_m / max(count, 1)
            rounds.append(Round(path, float(rng.uniform(1.1, 1.6)), slots))
    return rounds


def draw_crossers(place: Place, rng: np.random.Generator) -> list[Crosser]:
    """Draw up to two people for each zebra crossing between sidewalks."""
    halves: dict[tuple[int, bool], list[tuple[int, Side]]] = {}
    for index, ring in enumerate(place.network.rings):
        for side in ring.sides:
            for end in (False, True):
                halves.setdefault((side.edge, end), []).append((index, side))
    crossers = []
    for arm in sorted(place.crossings):
        pair = halves[arm]
        if all(place.paved[index] for index, _ in pair) and pair[0][0] != pair[1][0]:
            places = (-_ACROSS_M, _ACROSS_M)[: int(rng.integers(3))]
            crossers += [_crosser(place, pair, arm, across, rng) for across in places]
    return crossers


def _crosser(
    place: Place, pair: list[tuple[int, Side]], arm: tuple[int, bool], across: float, rng: np.random.Generator
) -> Crosser:
    into = 0.5 * (CROSSING_M[0] + CROSSING_M[1]) + across
    kerbs = []
    for _, side in pair:
        s = side.along_m[-1] - into if side.forward == arm[1] else side.along_m[0] + into
        kerbs.append(interpolate(s, side.along_m, side.kerb_m))
    if rng.uniform() < 0.5:
        kerbs.reverse()
    ahead = (kerbs[1] - kerbs[0]) / np.linalg.norm(kerbs[1] - kerbs[0])
    ends = [kerbs[0] - _WAIT_M * ahead, kerbs[1] + _WAIT_M * ahead]
    start, end = (place.terrain.points(xy, KERB_M) for xy in ends)
    pace, rest, ready = (float(rng.uniform(*span)) for span in ((1.2, 1.7), (8.0, 30.0), (0.0, 25.0)))
    return Crosser(arm, start, end, pace, rest, ready)


def crossing_point(place: Place, crosser: Crosser, fraction: float) -> np.ndarray:
    """Return the (3,) foot point on a crossing: up on the kerbs, otherwise on the crown of the street."""
    xy = crosser.start_m[:2] + fraction * (crosser.end_m[:2] - crosser.start_m[:2])
    length = float(np.linalg.norm(crosser.end_m - crosser.start_m))
    from_middle = abs(2 * fraction - 1) * length / (length - 2 * _WAIT_M)
    lift = KERB_M if from_middle > 1 else CROWN_M * (1 - from_middle)
    return place.terrain.points(xy, lift)
