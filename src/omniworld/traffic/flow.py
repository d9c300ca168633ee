"""Traffic flow: cars follow each other, and wait at junctions for each other and for people at crossings.

It is simulated in steps from the start of the scene and remembered, so that times can be requested in any order.
Cars follow the intelligent driver model (Treiber, Hennecke, Helbing 2000, eq. 3). Before a junction every car requests
the right of way, and stops at the line until no clashing turn has it; people at a crossing do the same.
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from omniocc.seeding import choice
from omniworld.traffic.lanes import Arm, Roads

STEP_S = 0.2
_ACCELERATE_MPS2, _BRAKE_MPS2, _HARDEST_MPS2 = 1.8, 2.0, 6.0
_GAP_M, _GAP_S = 2.2, 1.1
_CLEAR_M = 5.0  # beyond the end of the turn, where a car gives its right of way back: past the zebra crossing
_PATIENCE_S = 5.0  # after this wait, later arrivals with a clashing turn are held back
_LOOK_M = 45.0
_YELLOW_STEPS = 8


@dataclass
class Car:
    """A vehicle: size, its route (pieces and the arc lengths of their starts), and its motion at the newest step."""

    length_m: float
    top_mps: float
    pieces: list[int]
    starts_m: list[float]
    along_m: float
    speed_mps: float
    right_of_way: list[int] = field(default_factory=list)
    requested_s: float = -1.0

    def current(self) -> int:
        """Return the index into `pieces` of the piece under the car's middle."""
        return bisect_right(self.starts_m, self.along_m) - 1


@dataclass
class Crosser:
    """A person who walks to and fro between `start_m` and `end_m` (3,) over the crossing at `arm`.

    `moves` are (time, direction) of each start; `ready_s` is the time of the next wish to cross.
    """

    arm: Arm
    start_m: np.ndarray
    end_m: np.ndarray
    pace_mps: float
    rest_s: float
    ready_s: float
    moves: list[tuple[float, float]] = field(default_factory=list)

    @property
    def duration_s(self) -> float:
        """Return the time to cross the street."""
        return float(np.linalg.norm(self.end_m - self.start_m)) / self.pace_mps

    def progress(self, time_s: float) -> tuple[float, float]:
        """Return the fraction of the crossing walked, and the direction (+1, -1, or 0 while waiting)."""
        k = bisect_right(self.moves, (time_s, 2.0)) - 1
        if k < 0:
            return (0.0, 0.0)
        since, direction = self.moves[k]
        fraction = min((time_s - since) / self.duration_s, 1.0)
        return (fraction if direction > 0 else 1 - fraction), (direction if fraction < 1 else 0.0)


class Flow:
    """Cars and crossing people of a place from time 0 on; `rng` draws turns and waiting times."""

    def __init__(self, roads: Roads, cars: list[Car], crossers: list[Crosser], rng: np.random.Generator) -> None:
        self.roads, self.cars, self.crossers = roads, cars, crossers
        self._rng = rng
        self._lane_count = len(roads.lanes)
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self._open: list[frozenset[Arm]] = [frozenset()]
        self._remember()

    def motion(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return arc length (K,) and speed (K,) of each car at a time from 0 on."""
        step = int(time_s / STEP_S)
        self.run_to(time_s)
        (along, speed), (_, after) = self._past[step], self._past[step + 1]
        since = time_s - step * STEP_S
        gain = (after - speed) / STEP_S
        return along + since * (speed + 0.5 * gain * since), speed + gain * since

    def run_to(self, time_s: float) -> None:
        """Simulate until the remembered steps include the time."""
        while len(self._past) < int(time_s / STEP_S) + 2:
            self._step((len(self._past) - 1) * STEP_S)

    def signal(self, arm: Arm, time_s: float) -> int:
        """Return the light at an arm: red (0), yellow (1), or green (2) while a car has the right of way."""
        step = int(time_s / STEP_S)
        self.run_to(time_s)
        if arm in self._open[step]:
            return 2
        return int(any(arm in before for before in self._open[max(step - _YELLOW_STEPS, 0) : step]))

    def place(self, car: int, along_m: float) -> np.ndarray:
        """Return the (3,) point of the road at an arc length of a car's route."""
        way = self.cars[car]
        k = max(bisect_right(way.starts_m, along_m) - 1, 0)
        piece, at = self.roads.pieces[way.pieces[k]], along_m - way.starts_m[k]
        position = min(max(at / piece.length_m, 0.0), 1.0) * (len(piece.along_m) - 1)
        low = min(int(position), len(piece.along_m) - 2)
        a, b = piece.points_m[low], piece.points_m[low + 1]
        return a + (position - low) * (b - a)

    def _remember(self) -> None:
        self._past.append((np.array([c.along_m for c in self.cars]), np.array([c.speed_mps for c in self.cars])))

    def _step(self, time_s: float) -> None:
        current = [car.current() for car in self.cars]
        onto: dict[int, list[tuple[float, int]]] = {}
        for index, (car, k) in enumerate(zip(self.cars, current, strict=True)):
            self._extend(car, k)
            onto.setdefault(car.pieces[k], []).append((car.along_m - car.starts_m[k], index))
            car.right_of_way = [
                k2 for k2 in car.right_of_way if car.along_m - 0.5 * car.length_m < car.starts_m[k2 + 1] + _CLEAR_M
            ]
        for row in onto.values():
            row.sort()
        self._give_way(time_s, current, onto)
        coming = (car.pieces[k] for car, k in zip(self.cars, current, strict=True) if k + 1 in car.right_of_way)
        self._open.append(frozenset(self.roads.lanes[lane].end for lane in coming if lane < self._lane_count))
        push = [self._acceleration(index, k, onto) for index, k in enumerate(current)]
        for car, gain in zip(self.cars, push, strict=True):
            after = max(car.speed_mps + gain * STEP_S, 0.0)
            car.along_m += 0.5 * (car.speed_mps + after) * STEP_S
            car.speed_mps = after
        self._remember()

    def _extend(self, car: Car, k: int) -> None:
        """Add turns, each with the lane after it, until at least three pieces follow piece `k`, which the car is on."""
        while len(car.pieces) < k + 4:
            turn = choice(self._rng, self.roads.onward[car.pieces[-1]])
            for piece in (turn, self.roads.turn(turn).target):
                car.starts_m.append(car.starts_m[-1] + self.roads.pieces[car.pieces[-1]].length_m)
                car.pieces.append(piece)

    def _give_way(self, time_s: float, current: list[int], onto: dict[int, list[tuple[float, int]]]) -> None:
        """Give cars the right of way and let people cross, in the order of their requests."""
        taken = {car.pieces[k] for car in self.cars for k in car.right_of_way}
        used = {arm for piece in taken for arm in self._ends(piece)}
        walked = {c.arm for c in self.crossers if c.moves and c.moves[-1][0] + c.duration_s > time_s}
        requests = [(c.ready_s, -1 - n) for n, c in enumerate(self.crossers) if c.ready_s <= time_s]
        requests += [(car.requested_s, n) for n, car in enumerate(self.cars) if self._requests(car, current[n], time_s)]
        reserved: set[int] = set()
        kept: set[Arm] = set()
        for since, number in sorted(requests):
            late = time_s - since > _PATIENCE_S
            if number < 0:
                crosser = self.crossers[-1 - number]
                if crosser.arm not in used and crosser.arm not in kept:
                    crosser.moves.append((time_s, -crosser.moves[-1][1] if crosser.moves else 1.0))
                    rest_s = crosser.rest_s * float(self._rng.uniform(0.5, 1.5))
                    crosser.ready_s = time_s + crosser.duration_s + rest_s
                    walked.add(crosser.arm)
                elif late:
                    walked.add(crosser.arm)  # then cars wait, and this person goes next
                continue
            car, k = self.cars[number], current[number]
            turn = car.pieces[k + 1]
            clashes = self.roads.turn(turn).clashes
            ends = self._ends(turn)
            if not (clashes & taken or turn in reserved or walked & ends) and self._has_room(number, k, onto):
                car.right_of_way.append(k + 1)
                car.requested_s = -1.0
                taken.add(turn)
                used |= ends
            elif late:
                reserved |= clashes
                kept |= ends if not walked & ends else set()

    def _ends(self, piece: int) -> set[Arm]:
        turn = self.roads.turn(piece)
        return {self.roads.lanes[turn.origin].end, self.roads.lanes[turn.target].start}

    def _requests(self, car: Car, k: int, time_s: float) -> bool:
        """Return whether a car needs the right of way: it is near the end of its lane and does not have it yet."""
        lane = car.pieces[k]
        if lane >= self._lane_count or k + 1 in car.right_of_way:
            return False
        left_m = car.starts_m[k] + self.roads.lanes[lane].stop_m - car.along_m - 0.5 * car.length_m
        if left_m > 10 + car.speed_mps**2 / (1.4 * _BRAKE_MPS2):
            return False
        if car.requested_s < 0:
            car.requested_s = time_s
        return True

    def _has_room(self, number: int, k: int, onto: dict[int, list[tuple[float, int]]]) -> bool:
        """Return whether no car ahead in the lane waits and the lane behind the junction can take the whole car."""
        car = self.cars[number]
        at = car.along_m - car.starts_m[k]
        for position, other in onto[car.pieces[k]]:
            if position > at and not self.cars[other].right_of_way:
                return False
        room = self.roads.pieces[car.pieces[k + 2]].length_m
        for position, other in onto.get(car.pieces[k + 2], ())[:1]:
            room = position - 0.5 * self.cars[other].length_m
        for other in self.cars:
            onto_lane = [j + 1 for j in other.right_of_way if other.pieces[j + 1] == car.pieces[k + 2]]
            if other is not car and any(other.along_m < other.starts_m[j] for j in onto_lane):
                room -= other.length_m + 2 * _GAP_M
        return room > _CLEAR_M + car.length_m + 2 * _GAP_M

    def _acceleration(self, number: int, k: int, onto: dict[int, list[tuple[float, int]]]) -> float:
        car = self.cars[number]
        pieces, lane = self.roads.pieces, car.pieces[k] < self._lane_count
        left_m = car.starts_m[k + 1] - car.along_m
        top = min(car.top_mps, pieces[car.pieces[k]].speed_mps)
        if lane:
            slow = pieces[car.pieces[k + 1]].speed_mps
            top = min(top, sqrt(slow * slow + 2 * 1.3 * max(left_m - 0.5 * car.length_m, 0.0)))
        gain = 1 - (car.speed_mps / top) ** 4
        gap, ahead_mps = self._ahead(number, k, onto)
        if lane and k + 1 not in car.right_of_way:
            line = car.starts_m[k] + self.roads.lanes[car.pieces[k]].stop_m - car.along_m - 0.5 * car.length_m
            if line + 1.2 < gap:
                gap, ahead_mps = line + 1.2, 0.0
        if gap < _LOOK_M + 20:
            closing = car.speed_mps * (car.speed_mps - ahead_mps) / (2 * sqrt(_ACCELERATE_MPS2 * _BRAKE_MPS2))
            desired = _GAP_M + max(car.speed_mps * _GAP_S + closing, 0.0)
            gain -= (desired / max(gap, 0.1)) ** 2
        return max(_ACCELERATE_MPS2 * max(gain, -3.0), -_HARDEST_MPS2)

    def _ahead(self, number: int, k: int, onto: dict[int, list[tuple[float, int]]]) -> tuple[float, float]:
        """Return the free metres to the rear of the next car on the route, and its speed."""
        car = self.cars[number]
        for j in range(k, min(k + 3, len(car.pieces))):
            if car.starts_m[j] - car.along_m > _LOOK_M:
                break
            at = car.along_m - car.starts_m[j]
            for position, other in onto.get(car.pieces[j], ()):
                if other != number and (j > k or position > at):
                    found = self.cars[other]
                    return position - at - 0.5 * (car.length_m + found.length_m), found.speed_mps
        return 1e3, 0.0
