"""Everything that moves in a place, the ego included, as a function of time."""

from dataclasses import dataclass

import numpy as np

from omniocc import seeding
from omniocc.seeding import weighted_choice
from omniworld.assets import person, pole, vehicle
from omniworld.assets.catalog import people, random_variant
from omniworld.assets.vehicle import EGO_ROAD_M, PAINTS, painted, size_m
from omniworld.mesh.label import PEDESTRIAN, VEHICLE
from omniworld.mesh.mesh import Mesh, concatenate, transform, with_instance
from omniworld.mesh.shape import upright_pose
from omniworld.town.line import interpolate
from omniworld.town.marking import CROSSING_M
from omniworld.town.network import Side, degrees
from omniworld.town.place import Place
from omniworld.town.road import CROWN_M, KERB_M
from omniworld.town.street import furniture_m
from omniworld.traffic import lanes
from omniworld.traffic.flow import Car, Crosser, Flow
from omniworld.traffic.lanes import Path, Roads, close, node_of

_RANGE_M = 80.0
_WARM_UP_S = 10.0
_WHEELBASE_FRACTION = 0.6  # of a vehicle's length
_TOP_MPS = {"bicycle": 5.0, "truck": 11.0, "bus": 11.0}
# Cars start at least this far before a junction, to be able to stop, or behind one, to have left it.
_BEFORE_JUNCTION_M, _BEHIND_M = 32.0, 16.0
_LEAST_SPACE_M = 2.5
_WAIT_M = 0.35  # distance from the kerb while waiting
_ACROSS_M = 0.8  # of each person from the middle of a crossing


@dataclass(frozen=True)
class Actor:
    """A vehicle or person that moves.

    Attributes:
        id: the instance number of its faces.
        label: class id.
        world_from_actor: (4, 4) float64; the origin is on the ground below its middle, x forward.
        size_m: extent along the actor's x, y, z.
        velocity_mps: (2,) in the world frame.
    """

    id: int
    label: int
    world_from_actor: np.ndarray
    size_m: tuple[float, float, float]
    velocity_mps: tuple[float, float]


class Traffic:
    """The traffic of a place; all methods depend only on the time (0 or later)."""

    def __init__(self, place: Place, seed: int) -> None:
        rng = seeding.generator(place.theme.name, seed, "traffic")
        self._place = place
        roads = lanes.draw(place.theme, place.network, place.terrain, place.crossings, rng)
        meshes, cars = draw_fleet(place, roads, rng)
        self._rounds = draw_rounds(place, rng)
        self._sway_draws = rng.uniform(size=(3, 3, 2))
        self._warm_up_s = float(rng.uniform(0, _WARM_UP_S))
        paint = rng.integers(len(PAINTS), size=len(cars))
        self._cars = [painted(mesh, PAINTS[k]) for mesh, k in zip(meshes, paint, strict=True)]
        self._flow = Flow(roads, cars, draw_crossers(place, rng), rng)

    def world_from_ego(self, time_s: float) -> np.ndarray:
        """Return the (4, 4) float64 pose of the ego frame, 2.2 m above the road.

        The car pitches and rolls by about 0.02 rad and heaves by 0.1 m (standard deviations) on top of the slope.
        """
        along = float(self._flow.motion(time_s + self._warm_up_s)[0][0])
        front, rear = self._flow.place(0, along + 1.4), self._flow.place(0, along - 1.4)
        road = _vehicle_pose(self._place, 0.5 * (front + rear), front - rear)
        roll, pitch, heave = (_sway(time_s, draws) for draws in self._sway_draws)
        pose = road.copy()
        pose[:3, :3] = road[:3, :3] @ _tilt(0.02 * roll, 0.02 * pitch)
        pose[:3, 3] += road[:3, 2] * (0.1 * heave - EGO_ROAD_M)
        return pose

    def actors(self, time_s: float) -> tuple[Mesh, tuple[Actor, ...]]:
        """Return the moving objects within 80 m of the ego: faces in the world frame (instance = actor id), and actors.

        Lit lamps of traffic lights are among the faces, with an instance below -1 for each light.
        """
        ego_xy = self.world_from_ego(time_s)[:2, 3]
        pairs = [*self._driving(time_s, ego_xy), *self._walking(time_s, ego_xy), *self._crossing(time_s, ego_xy)]
        moved = (with_instance(transform(mesh, actor.world_from_actor), actor.id) for mesh, actor in pairs)
        return concatenate([*moved, *self._lamps(time_s, ego_xy)]), tuple(actor for _, actor in pairs)

    def _lamps(self, time_s: float, ego_xy: np.ndarray) -> list[Mesh]:
        """Return the lit lamps of the traffic lights within `_RANGE_M` of the ego, world frame."""
        lit = []
        for number, signal in enumerate(self._place.signals):
            x, y, yaw = signal.pose.x_m, signal.pose.y_m, signal.pose.yaw_rad
            if np.hypot(x - ego_xy[0], y - ego_xy[1]) < _RANGE_M:
                shown = self._flow.signal(signal.arm, time_s + self._warm_up_s)
                foot = np.array([x, y, float(self._place.terrain.height(x, y)) + KERB_M])
                lamps = transform(pole.lit_lamps(shown), upright_pose(foot, yaw))
                lit.append(with_instance(lamps, -2 - number))
        return lit

    def _driving(self, time_s: float, ego_xy: np.ndarray) -> list[tuple[Mesh, Actor]]:
        found = []
        along, speed = self._flow.motion(time_s + self._warm_up_s)
        for car in range(1, len(along)):
            if np.linalg.norm(self._flow.place(car, along[car])[:2] - ego_xy) > _RANGE_M:
                continue
            half = 0.5 * _WHEELBASE_FRACTION * self._flow.cars[car].length_m
            front, rear = self._flow.place(car, along[car] + half), self._flow.place(car, along[car] - half)
            pose = _vehicle_pose(self._place, 0.5 * (front + rear), front - rear)
            velocity_mps = (float(speed[car] * pose[0, 0]), float(speed[car] * pose[1, 0]))
            found.append((self._cars[car], Actor(car, VEHICLE, pose, size_m(self._cars[car]), velocity_mps)))
        return found

    def _walking(self, time_s: float, ego_xy: np.ndarray) -> list[tuple[Mesh, Actor]]:
        found, number = [], len(self._cars)
        for walk in self._rounds:
            along = walk.along_m + walk.speed_mps * time_s
            points, ahead = (walk.path.at(np.mod(s, walk.path.length_m)) for s in (along, along + 0.5))
            direction = ahead - points
            for k in np.flatnonzero(np.linalg.norm(points[:, :2] - ego_xy, axis=1) < _RANGE_M):
                velocity = walk.speed_mps * direction[k, :2] / np.linalg.norm(direction[k])
                found.append(_person(number + int(k), points[k], direction[k], velocity, float(along[k])))
            number += len(along)
        return found

    def _crossing(self, time_s: float, ego_xy: np.ndarray) -> list[tuple[Mesh, Actor]]:
        found, number = [], len(self._cars) + sum(len(walk.along_m) for walk in self._rounds)
        for k, crosser in enumerate(self._flow.crossers):
            fraction, sign = crosser.progress(time_s + self._warm_up_s)
            point = crossing_point(self._place, crosser, fraction)
            if np.linalg.norm(point[:2] - ego_xy) > _RANGE_M:
                continue
            way = crosser.end_m - crosser.start_m
            direction = way * (sign or (1.0 if fraction < 0.5 else -1.0))
            velocity = sign * way[:2] / crosser.duration_s
            pace_m = fraction * float(np.linalg.norm(way)) if sign else 0.0
            found.append(_person(number + k, point, direction, velocity, pace_m))
        return found


def _person(
    number: int, point: np.ndarray, direction: np.ndarray, velocity: np.ndarray, pace_m: float
) -> tuple[Mesh, Actor]:
    """Return prototype mesh and actor of a person who has walked `pace_m` since the first pose of a stride."""
    poses, size = people()[number % len(people())]
    mesh = poses[int(pace_m / person.STRIDE_M * person.PHASES) % person.PHASES]
    pose = upright_pose(point, float(np.arctan2(direction[1], direction[0])))
    return mesh, Actor(number, PEDESTRIAN, pose, size, (float(velocity[0]), float(velocity[1])))


def _vehicle_pose(place: Place, point: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the pose of a car on the road: x along `direction` (with its slope), rolled with the land."""
    forward = direction / np.linalg.norm(direction)
    left = np.array([-forward[1], forward[0], 0.0])
    left /= np.linalg.norm(left)
    beside = point[:2] + np.array([[1.0], [-1.0]]) * left[:2]
    rise = place.terrain.height(*beside.T)
    left[2] = 0.5 * (rise[0] - rise[1])
    up = np.cross(forward, left)
    up /= np.linalg.norm(up)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([forward, np.cross(up, forward), up], 1)
    pose[:3, 3] = point
    return pose


def _tilt(roll_rad: float, pitch_rad: float) -> np.ndarray:
    cr, sr, cp, sp = np.cos(roll_rad), np.sin(roll_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def _sway(time_s: float, draws: np.ndarray) -> float:
    """Return a sum of three sines of 0.1 to 1 Hz with unit variance; `draws` (3, 2) set frequency and phase."""
    frequency_hz = np.array([0.12, 0.35, 0.8]) * (0.8 + 0.4 * draws[:, 0])
    phase = 2 * np.pi * (frequency_hz * time_s + draws[:, 1])
    return float((np.sqrt(2) * np.array([0.75, 0.55, 0.37]) * np.sin(phase)).sum())


def draw_fleet(place: Place, roads: Roads, rng: np.random.Generator) -> tuple[list[Mesh], list[Car]]:
    """Draw cars spread over the lanes, about a headway apart; the first is the ego, whose mesh is not used."""
    meshes, cars = [], []
    for number, (lane, along) in enumerate(_slots(place, roads, rng)):
        kind = "hatchback" if number == 0 else weighted_choice(rng, place.theme.traffic)
        mesh = random_variant(rng, "vehicle", kind)
        length = vehicle.EGO_LENGTH_M if number == 0 else vehicle.size_m(mesh)[0]
        top = _TOP_MPS.get(kind, 15.0)
        cars.append(Car(length, top, [lane], [0.0], along, 0.75 * min(top, roads.pieces[lane].speed_mps)))
        meshes.append(mesh)
    return meshes, cars


def _slots(place: Place, roads: Roads, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Return (lane, arc length) of every car, in random order, at least 22 m apart."""
    slots = []
    for lane in range(len(roads.lanes)):
        piece = roads.pieces[lane]
        gap = max(place.theme.car_headway_s * piece.speed_mps, 22.0)
        along = _BEHIND_M + float(rng.uniform()) * gap
        while along < piece.length_m - _BEFORE_JUNCTION_M:
            slots.append((lane, along))
            along += gap * float(rng.uniform(1.0, 1.6))
    if not slots:
        slots = [(0, _BEHIND_M)]
    order = [slots[int(k)] for k in rng.permutation(len(slots))]
    if place.theme.island_m:  # so that the ego soon reaches a roundabout
        meeting = degrees(place.network)
        order.sort(key=lambda slot: -meeting[node_of(place.network, roads.lanes[slot[0]].end)])
    return order


@dataclass(frozen=True)
class Round:
    """Walkers on one closed path around a block: (K,) arc lengths at time 0, one speed for all."""

    path: Path
    speed_mps: float
    along_m: np.ndarray


def draw_rounds(place: Place, rng: np.random.Generator) -> list[Round]:
    """Draw two files of walkers around every block with a sidewalk, in opposite directions; one where it is narrow."""
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
