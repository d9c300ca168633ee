"""The vehicles of a scene and where they start; vehicle 0 is the ego."""

import numpy as np

from omniocc.seeding import weighted_choice
from omniworld.assets import vehicle
from omniworld.assets.catalog import random_variant
from omniworld.mesh.mesh import Mesh
from omniworld.town.network import degrees
from omniworld.town.place import Place
from omniworld.traffic.flow import Car
from omniworld.traffic.lanes import Roads, node_of

_TOP_MPS = {"bicycle": 5.0, "truck": 11.0, "bus": 11.0}
# Cars start at least this far before a junction, to be able to stop, or behind one, to have left it.
_BEFORE_JUNCTION_M, _BEHIND_M = 32.0, 16.0


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
