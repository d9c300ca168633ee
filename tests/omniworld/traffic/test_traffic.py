"""Traffic: actors and objects never overlap, the ego stays on the road and moves smoothly."""

import time
from bisect import bisect_right
from functools import cache

import numpy as np
import pytest

from omniworld.assets.vehicle import ego_car
from omniworld.render.cull import spheres_of
from omniworld.town import place as places
from omniworld.town.place import THEMES
from omniworld.traffic.traffic import Actor, Traffic

_EGO_SIZE_M = (4.6, 2.0, 1.65)
_TIMES_S = np.arange(0.0, 180.0, 3.7)
_SEEDS = (3, 11)


@cache
def world(theme: str, seed: int = 3) -> tuple[places.Place, Traffic]:
    place = places.build(theme, seed)
    return place, Traffic(place, seed)


def rectangle(pose: np.ndarray, size_m: tuple[float, float, float]) -> np.ndarray:
    local = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size_m[:2]
    forward = pose[:2, 0] / np.linalg.norm(pose[:2, 0])
    return pose[:2, 3] + local[:, :1] * forward + local[:, 1:] * np.array([-forward[1], forward[0]])


def overlap(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether two rectangles (4, 2) overlap, by their separating axes."""
    for edge in (a[1] - a[0], a[2] - a[1], b[1] - b[0], b[2] - b[1]):
        p, q = a @ edge, b @ edge
        if p.max() <= q.min() or q.max() <= p.min():
            return False
    return True


def rectangles(traffic: Traffic, time_s: float) -> tuple[list[np.ndarray], tuple[Actor, ...]]:
    actors = traffic.actors(time_s)[1]
    return [rectangle(traffic.world_from_ego(time_s), _EGO_SIZE_M)] + [
        rectangle(a.world_from_actor, a.size_m) for a in actors
    ], actors


@pytest.mark.parametrize("seed", _SEEDS)
@pytest.mark.parametrize("theme", THEMES)
def test_no_actor_passes_through_another(theme: str, seed: int) -> None:
    _, traffic = world(theme, seed)
    found = []
    for time_s in _TIMES_S if seed == _SEEDS[0] else _TIMES_S[::2]:
        boxes, actors = rectangles(traffic, time_s)
        names = ["ego", *(f"{a.id} (label {a.label})" for a in actors)]
        middles = np.array([box.mean(0) for box in boxes])
        near = np.linalg.norm(middles[:, None] - middles[None], axis=-1) < 12
        for i, j in np.argwhere(np.triu(near, 1)):
            if overlap(boxes[i], boxes[j]):
                found.append((round(float(time_s), 1), names[i], names[j]))
    assert found == []


@pytest.mark.parametrize("theme", THEMES)
def test_no_actor_passes_through_a_static_object(theme: str) -> None:
    """No corner, edge or face centre of a static object is in an actor's box more than 0.2 m above the ground."""
    place, traffic = world(theme)
    corners = place.mesh.vertices[place.mesh.faces[np.isin(place.mesh.label, (4, 5, 6, 7, 8, 9))]].astype(float)
    label = place.mesh.label[np.isin(place.mesh.label, (4, 5, 6, 7, 8, 9))]
    near = corners[..., 2].min(1) < place.terrain.height(*corners[:, 0, :2].T) + 4.5
    (a, b, c), label = corners[near].transpose(1, 0, 2), label[near]
    points = np.concatenate([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
    labels = np.tile(label, 7)
    low = points[:, 2] < place.terrain.height(points[:, 0], points[:, 1]) + 3.6
    order = np.argsort(points[low, 0])
    points, labels = points[low][order], labels[low][order]
    found = []
    for time_s in _TIMES_S[::3]:
        ego = traffic.world_from_ego(time_s).copy()
        ego[:3, 3] -= 2.2 * ego[:3, 2]
        objects = [("ego", ego, _EGO_SIZE_M)] + [
            (str(x.label), x.world_from_actor, x.size_m) for x in traffic.actors(time_s)[1]
        ]
        for name, pose, size in objects:
            first, last = np.searchsorted(points[:, 0], pose[0, 3] + np.array([-8, 8]))
            local = (points[first:last] - pose[:3, 3]) @ pose[:3, :3]
            inside = (np.abs(local[:, 0]) < size[0] / 2) & (np.abs(local[:, 1]) < size[1] / 2)
            inside &= (local[:, 2] > 0.2) & (local[:, 2] < size[2])
            if inside.any():
                found.append((round(float(time_s), 1), name, int(labels[first:last][inside][0])))
    assert found == []


@pytest.mark.parametrize("theme", THEMES)
def test_the_ego_stays_on_the_road_for_three_minutes(theme: str) -> None:
    place, traffic = world(theme)
    mesh = place.mesh
    road = np.isin(mesh.label, (1, 11))
    corners = mesh.vertices[mesh.faces[road]].astype(float)
    a, b, c = corners.transpose(1, 0, 2)
    for time_s in np.arange(0, 180, 2.5):
        pose = traffic.world_from_ego(time_s)
        foot = pose[:3, 3] - 2.2 * pose[:3, 2]

        def side(p: np.ndarray, q: np.ndarray, foot: np.ndarray = foot) -> np.ndarray:
            return (q - p)[:, 0] * (foot - p)[:, 1] - (q - p)[:, 1] * (foot - p)[:, 0]

        under = np.flatnonzero((side(a, b) >= 0) & (side(b, c) >= 0) & (side(c, a) >= 0))
        assert len(under), f"no road under the ego at {time_s} s"
        normal = np.cross(b[under[0]] - a[under[0]], c[under[0]] - a[under[0]])
        above = normal @ (foot - a[under[0]]) / normal[2]
        assert abs(above) < 0.35, f"{above:.2f} m above the road at {time_s} s"  # heave, and lines on the road


@pytest.mark.parametrize("theme", THEMES)
def test_the_ego_moves_smoothly(theme: str) -> None:
    _, traffic = world(theme)
    step = 0.1
    poses = np.stack([traffic.world_from_ego(t) for t in np.arange(0, 180, step)])
    assert poses.dtype == np.float64
    np.testing.assert_allclose(
        poses[:, :3, :3].transpose(0, 2, 1) @ poses[:, :3, :3], np.tile(np.eye(3), (len(poses), 1, 1)), atol=1e-9
    )
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / step
    assert speed.max() < 15
    assert speed.mean() > 2.5
    assert np.abs(np.diff(speed)).max() / step < 6
    turn = np.arccos(np.clip((poses[1:, :3, 0] * poses[:-1, :3, 0]).sum(1), -1, 1)) / step
    assert turn.max() < 1.2
    pitch_and_roll = np.std(poses[:, 2, :2], axis=0)
    assert (pitch_and_roll > 0.01).all()
    assert (pitch_and_roll < 0.08).all()


@pytest.mark.parametrize("theme", ["suburb", "downtown"])
def test_any_time_in_any_order(theme: str) -> None:
    """Steps are simulated once and remembered; reading them changes nothing."""
    place, traffic = world(theme)
    again = Traffic(place, 3)
    later, first = again.actors(50.0), again.actors(4.0)
    for mine, theirs in ((traffic.actors(4.0), first), (traffic.actors(50.0), later)):
        np.testing.assert_array_equal(mine[0].vertices, theirs[0].vertices)
        assert [a.id for a in mine[1]] == [a.id for a in theirs[1]]
    np.testing.assert_array_equal(traffic.world_from_ego(50.0), again.world_from_ego(50.0))
    assert not np.allclose(Traffic(place, 4).world_from_ego(0.0), traffic.world_from_ego(0.0))


@pytest.mark.parametrize("theme", THEMES)
def test_actors_carry_their_faces_and_speeds(theme: str) -> None:
    _, traffic = world(theme)
    start = time.perf_counter()
    mesh, actors = traffic.actors(12.0)
    print(f"{theme}: {len(actors)} actors, {1e3 * (time.perf_counter() - start):.1f} ms")
    assert len({a.id for a in actors}) == len(actors) > 3
    assert set(np.unique(mesh.instance[mesh.instance >= 0])) == {a.id for a in actors}
    assert set(np.unique(mesh.label[mesh.instance < 0])) <= {9}  # lamps of traffic lights
    assert spheres_of(mesh)[:, 3].max() < 9  # wide spheres would make every ray a candidate for moving objects
    later = {a.id: a for a in traffic.actors(12.1)[1]}
    middle = traffic.world_from_ego(12.0)[:2, 3]
    for actor in actors:
        faces = mesh.instance == actor.id
        assert set(np.unique(mesh.label[faces])) == {actor.label}
        inverse = np.linalg.inv(actor.world_from_actor)
        local = mesh.vertices[np.unique(mesh.faces[faces])] @ inverse[:3, :3].T + inverse[:3, 3]
        assert (np.abs(local[:, :2]) < 0.5 * np.array(actor.size_m[:2]) + 0.12).all()
        assert local[:, 2].min() > -0.15
        assert np.linalg.norm(actor.world_from_actor[:2, 3] - middle) < 80
        if actor.id in later:
            moved = (later[actor.id].world_from_actor[:2, 3] - actor.world_from_actor[:2, 3]) / 0.1
            assert np.linalg.norm(moved - actor.velocity_mps) < 1.0


def test_people_walk_and_cars_drive_somewhere() -> None:
    labels, crossing = set(), 0
    for theme in THEMES:
        _, traffic = world(theme)
        labels |= {a.label for t in (0.0, 40.0) for a in traffic.actors(t)[1]}
        crossing += len(traffic._flow.crossers)
    assert labels == {7, 10}
    assert crossing >= 4


def test_the_ego_turns_both_ways_goes_straight_and_stops() -> None:
    ways, speeds = [], []
    for theme in THEMES:
        _, traffic = world(theme)
        poses = np.stack([traffic.world_from_ego(t) for t in np.arange(0, 180, 0.5)])
        speeds.append(np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1) / 0.5)
        azimuth = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
        ways.append(azimuth[16:] - azimuth[:-16])
    turn, speed = np.concatenate(ways), np.concatenate(speeds)
    assert turn.min() < -1.2
    assert turn.max() > 1.2
    assert 0.02 < (speed < 0.1).mean() < 0.4
    assert 11 < speed.max() < 15
    assert speed.mean() > 4


def test_traffic_lights_agree_with_the_cars() -> None:
    """Cars see green when they pass the line; cars that wait at the line mostly see red."""
    for theme in ("downtown", "arterial"):
        flow = world(theme)[1]._flow
        shown = {0: 0, 1: 0, 2: 0}
        for time_s in np.arange(1.0, 150.0, 0.2):
            (before, _), (along, speed) = flow.motion(time_s - 0.2), flow.motion(time_s)
            for k, car in enumerate(flow.cars):
                piece = bisect_right(car.starts_m, along[k]) - 1
                if car.pieces[piece] >= len(flow.roads.lanes):
                    continue
                lane, front = flow.roads.lanes[car.pieces[piece]], along[k] - car.starts_m[piece] + car.length_m / 2
                moved = along[k] - before[k]
                if front - moved < lane.stop_m < front:
                    assert flow.signal(lane.end, time_s) == 2
                if lane.stop_m - 2 < front < lane.stop_m and speed[k] < 0.05:
                    shown[flow.signal(lane.end, time_s)] += 1
        assert sum(shown.values()) > 50
        assert shown[0] > shown[2]


def test_ego_car_stands_below_the_rig() -> None:
    mesh = ego_car()
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    np.testing.assert_allclose(low[2], -2.2, atol=0.01)
    np.testing.assert_allclose(high[2], -0.55, atol=0.02)
    np.testing.assert_allclose(high[0] - low[0], 4.6, atol=0.1)
    assert set(np.unique(mesh.label)) == {7}
