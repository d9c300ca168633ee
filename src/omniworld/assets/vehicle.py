"""Cars, vans, trucks, buses and bicycles facing +x with their wheels on z = 0, and the ego car."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import VEHICLE
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate, transform
from omniworld.mesh.shape import Color, Number, Skin, beam, blob, box, lathe, loft, panel, quads

EGO_LENGTH_M = 4.6
EGO_ROAD_M = -2.2  # height of the road in the ego frame
PAINTS: tuple[Color, ...] = (
    (196, 198, 200),
    (236, 236, 234),
    (40, 42, 46),
    (96, 100, 106),
    (150, 30, 34),
    (34, 62, 120),
    (60, 92, 76),
    (190, 150, 60),
    (116, 84, 64),
    (150, 176, 196),
)
_EGO_PAINT = (128, 24, 28)
_PAINT = Skin(VEHICLE, Material.CAR_PAINT, (150, 150, 150))
_GLASS = Skin(VEHICLE, Material.GLASS, (38, 46, 54))
_RUBBER = Skin(VEHICLE, Material.RUBBER, (30, 30, 32))
_RIM = Skin(VEHICLE, Material.METAL, (150, 152, 154))
_TRIM = Skin(VEHICLE, Material.RUBBER, (44, 44, 48))
_HEADLIGHT = Skin(VEHICLE, Material.GLASS, (226, 228, 220))
_TAIL_LIGHT = Skin(VEHICLE, Material.SIGN, (170, 24, 24))
_PLATE = Skin(VEHICLE, Material.SIGN, (226, 226, 220))


def _wheel(x_m: Number, y_m: Number, radius_m: Number) -> Mesh:
    """Build a wheel around the y axis, its disc on the outer side."""
    tyre = lathe([radius_m, radius_m, 0], [-0.11, 0.1, 0.11], 9, _RUBBER)
    rim = lathe([0.62 * radius_m, 0], [0.112, 0.12], 6, _RIM)
    return transform(concatenate([tyre, rim]), _axle(x_m, y_m, radius_m, 1 if y_m > 0 else -1))


def _axle(x_m: Number, y_m: Number, z_m: Number, side: int) -> np.ndarray:
    """Return the (4, 4) pose of a wheel that `lathe` made: its upper end faces left (side 1) or right (-1)."""
    return np.array([[1.0, 0, 0, x_m], [0, 0, side, y_m], [0, -side, 0, z_m], [0, 0, 0, 1]])


def _lights(length_m: Number, width_m: Number, z_m: Number, tail_z_m: Number) -> list[Mesh]:
    parts = []
    for side in (-1, 1):
        front = (length_m / 2 - 0.05, side * (width_m / 2 - 0.3), z_m)
        rear = (-length_m / 2 + 0.03, side * (width_m / 2 - 0.2), tail_z_m)
        parts += [
            panel((0.1, 0.34, 0.14), front, _HEADLIGHT, "frbt"),
            panel((0.08, 0.24, 0.22), rear, _TAIL_LIGHT, "flb"),
        ]
    y, z = 0.25 * np.array([-1, 1, 1, -1]), 0.48 + 0.055 * np.array([-1, -1, 1, 1])
    for end in (-1, 1):
        face = np.stack([np.full(4, end * (length_m / 2 + 0.01)), end * y, z], 1)
        parts.append(quads(face[None], face[None, :, 1:], _PLATE))
    return parts


def _car(
    length: float,
    width: float,
    height: float,
    hood: float,
    cabin: tuple[float, float, float, float],
    belt: float = 0.92,
) -> Mesh:
    """Build a car: a body below the belt line, glass above it.

    `cabin`: x of rear foot, rear roof edge, front roof edge and front foot, as fractions of the length.
    """
    h, w = length / 2, width / 2
    body = np.array(
        [
            (-h, 0.36),
            (-h + 0.1, 0.24),
            (h - 0.15, 0.24),
            (h, 0.38),
            (h, 0.62),
            (h - 0.1, hood - 0.12),
            (cabin[3] * length, belt),
            (cabin[0] * length, belt + 0.02),
            (-h + 0.05, belt - 0.04),
            (-h, 0.7),
        ]
    )
    narrow = np.array([0.9, 0.94, 0.94, 0.86, 0.88, 0.9, 0.97, 0.97, 0.92, 0.95]) * w
    parts = [loft(body, narrow, [_TRIM, _TRIM, _TRIM] + [_PAINT] * 7, _PAINT)]
    rear, rear_top, front_top, front = (fraction * length for fraction in cabin)
    top = np.array(
        [
            (rear, belt),
            (front, belt - 0.02),
            (front_top, height - 0.03),
            (0.5 * (front_top + rear_top), height),
            (rear_top, height - 0.05),
        ]
    )
    narrow = np.array([0.94, 0.94, 0.76, 0.76, 0.75]) * w
    parts.append(loft(top, narrow, [_TRIM, _GLASS, _PAINT, _PAINT, _GLASS], _GLASS))
    pillar = 0.5 * (front_top + rear_top) - 0.05 * length
    parts += [beam((pillar, s * 0.93 * w, belt), (pillar, s * 0.765 * w, height - 0.05), 0.05, _PAINT) for s in (-1, 1)]
    radius = 0.31 + 0.03 * (height > 1.6)
    parts += [_wheel(x * length, s * (w - 0.1), radius) for x in (-0.31, 0.31) for s in (-1, 1)]
    parts += [panel((0.12, 0.18, 0.13), (front - 0.25, s * (w + 0.06), belt + 0.08), _PAINT, "frblt") for s in (-1, 1)]
    return concatenate(parts + _lights(length, width, 0.66, 0.76))


Span = tuple[float, float]


def _cars(
    length: Span, width: Span, height: Span, hood: float, cabin: tuple[float, float, float, float], belt: float = 0.92
) -> Callable[[np.random.Generator], Mesh]:
    """Return a builder of cars whose length, width and height are drawn between two values; see `_car`."""
    return lambda rng: _car(rng.uniform(*length), rng.uniform(*width), rng.uniform(*height), hood, cabin, belt)


sedan = _cars((4.3, 5.2), (1.75, 1.9), (1.4, 1.5), 0.9, (-0.38, -0.22, 0.02, 0.2))  # hood, cabin and trunk
hatchback = _cars((3.6, 4.3), (1.65, 1.8), (1.45, 1.58), 0.92, (-0.48, -0.38, 0.05, 0.24))  # short, with a steep tail
suv = _cars((4.4, 4.9), (1.82, 1.95), (1.65, 1.85), 1.05, (-0.48, -0.42, 0.04, 0.2), 1.05)  # high, with a long roof


def van(rng: np.random.Generator) -> Mesh:
    """Build a delivery van: closed box behind a short nose."""
    length, width, height = rng.uniform(5.0, 5.9), rng.uniform(1.9, 2.05), rng.uniform(1.95, 2.5)
    h, w = length / 2, width / 2
    outline = np.array(
        [(-h, 0.36), (h, 0.36), (h, 0.95), (h - 0.55, 1.2), (h - 1.25, height - 0.05), (h - 1.6, height), (-h, height)]
    )
    widths = np.array([1, 0.95, 0.93, 0.96, 0.92, 0.94, 0.95]) * w
    parts = [loft(outline, widths, [_TRIM, *[_PAINT] * 2, _GLASS, *[_PAINT] * 3], _PAINT)]
    parts += [box((0.8, 0.02, 0.5), (h - 1.5, s * (w * 0.965), 0.62 * height), _GLASS) for s in (-1, 1)]
    parts += [_wheel(x * length, s * (w - 0.1), 0.35) for x in (-0.31, 0.33) for s in (-1, 1)]
    return concatenate(parts + _lights(length, width, 0.8, 1.0))


def truck(rng: np.random.Generator) -> Mesh:
    """Build a truck: cab and cargo box."""
    length, width, height = rng.uniform(6.5, 8.2), rng.uniform(2.2, 2.4), rng.uniform(2.8, 3.4)
    h, w, cab = length / 2, width / 2, 1.9
    cargo = Skin(VEHICLE, Material.METAL, choice(rng, ((214, 214, 208), (92, 120, 140), (186, 120, 60))))
    outline = np.array([(h - cab, 0.5), (h, 0.5), (h, 1.3), (h - 0.35, 2.35), (h - cab, 2.45)])
    parts = [loft(outline, np.full(5, 0.95 * w), [_TRIM, _PAINT, _GLASS, _PAINT, _PAINT], _PAINT)]
    parts += [box((0.8, 0.02, 0.7), (h - 0.95, s * 0.96 * w, 1.75), _GLASS) for s in (-1, 1)]
    parts.append(box((length - cab - 0.15, width, height - 0.95), (-cab / 2 - 0.07, 0, (height + 0.95) / 2), cargo))
    parts.append(box((length - 0.6, 0.9, 0.35), (-0.2, 0, 0.75), _TRIM))
    parts += [_wheel(x, s * (w - 0.12), 0.45) for x in (-0.3 * length, h - 1.0) for s in (-1, 1)]
    return concatenate(parts + _lights(length, width, 0.8, 0.85))


def bus(rng: np.random.Generator) -> Mesh:
    """Build a city bus with a band of windows."""
    length, width, height = rng.uniform(8.6, 9.8), 2.4, rng.uniform(2.85, 3.1)
    h, w = length / 2, width / 2
    parts = [box((length, width, height - 0.35), (0, 0, (height + 0.35) / 2), _PAINT)]
    parts += [box((length - 0.5, 0.02, 0.95), (-0.05, s * (w + 0.005), 0.62 * height), _GLASS) for s in (-1, 1)]
    parts += [
        box((0.1, 0.04, 1.0), (x, s * (w + 0.005), 0.62 * height), _PAINT)
        for x in np.arange(-h + 1.4, h - 1, 1.4)
        for s in (-1, 1)
    ]
    parts += [box((0.02, width - 0.3, 1.3), (end * (h + 0.005), 0, 0.58 * height), _GLASS) for end in (-1, 1)]
    parts.append(box((0.04, 1.4, 0.25), (h + 0.01, 0, height - 0.2), Skin(VEHICLE, Material.LAMP, (240, 190, 60))))
    parts.append(box((1.6, 1.4, 0.25), (-1.0, 0, height + 0.1), _TRIM))
    parts += [_wheel(x * length, s * (w - 0.1), 0.46) for x in (-0.28, 0.3) for s in (-1, 1)]
    return concatenate(parts + _lights(length, width, 0.75, 0.9))


def bicycle(rng: np.random.Generator) -> Mesh:
    """Build a bicycle with its rider."""
    frame = Skin(VEHICLE, Material.METAL, choice(rng, PAINTS))
    cloth = Skin(VEHICLE, Material.CLOTH, choice(rng, PAINTS))
    trousers = Skin(VEHICLE, Material.CLOTH, (52, 56, 72))
    skin = Skin(VEHICLE, Material.SKIN, (198, 150, 122))
    axles = [_axle(x, 0.0, 0.34, s) for x in (-0.52, 0.52) for s in (-1, 1)]
    wheels = [transform(lathe([0.33, 0.35, 0.33], [-0.025, 0, 0.025], 10, _RUBBER), axle) for axle in axles[1::2]]
    disc = [transform(lathe([0.33, 0], [0, 0.005], 8, _RIM), axle) for axle in axles]
    bars = [
        beam((-0.52, 0, 0.34), (-0.15, 0, 0.85), 0.025, frame),
        beam((-0.15, 0, 0.85), (0.4, 0, 0.8), 0.025, frame),
        beam((0.52, 0, 0.34), (0.38, 0, 1.0), 0.025, frame),
        beam((-0.05, 0, 0.32), (0.4, 0, 0.75), 0.025, frame),
        beam((-0.52, 0, 0.34), (-0.05, 0, 0.32), 0.025, frame),
        beam((0.38, -0.28, 1.02), (0.38, 0.28, 1.02), 0.025, frame),
    ]
    rider = [
        beam((-0.18, 0, 0.95), (0.12, 0, 1.45), 0.19, cloth),
        blob(rng, (0.11, 0.1, 0.14), (0.2, 0, 1.66), skin, 0.03),
    ]
    for side in (-1, 1):
        rider.append(beam((0.08, side * 0.18, 1.4), (0.38, side * 0.24, 1.04), 0.05, cloth))
        rider.append(beam((-0.16, side * 0.09, 0.95), (0.16, side * 0.1, 0.78 - 0.1 * side), 0.075, trousers))
        rider.append(beam((0.16, side * 0.1, 0.78 - 0.1 * side), (0.02, side * 0.1, 0.3 - 0.1 * side), 0.06, trousers))
    return concatenate([*wheels, *disc, *bars, *rider])


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "sedan": sedan,
    "hatchback": hatchback,
    "suv": suv,
    "van": van,
    "truck": truck,
    "bus": bus,
    "bicycle": bicycle,
}


PARKED = {"sedan": 2.0, "hatchback": 2.0, "suv": 2.0, "van": 1.0}
"""Weights of the kinds that park along streets."""


def size_m(mesh: Mesh) -> tuple[float, float, float]:
    """Return the extent of a prototype along its x, y, z."""
    extent = mesh.vertices.max(0) - mesh.vertices.min(0)
    return float(extent[0]), float(extent[1]), float(extent[2])


def painted(mesh: Mesh, color: Color) -> Mesh:
    """Return a vehicle with its car paint in another colour."""
    paint = (mesh.material == Material.CAR_PAINT)[:, None]
    return replace(mesh, color=np.where(paint, np.array(color, np.uint8), mesh.color))


def ego_car() -> Mesh:
    """Build the ego car in the ego frame: 4.6 x 1.9 m, roof at z = -0.55 m, wheels on z = -2.2 m."""
    mesh = _car(EGO_LENGTH_M, 1.86, 1.65, 1.02, (-0.47, -0.4, 0.06, 0.22), 1.03)
    down = np.eye(4)
    down[2, 3] = EGO_ROAD_M
    return transform(painted(mesh, _EGO_PAINT), down)
