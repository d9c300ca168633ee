"""Rigs drawn at random, as various as those of cars and robots, so that a network learns none by heart."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.equidistant import Equidistant
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.ocam import OCam
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.models.radial_polynomial import RadialPolynomial
from omniocc.camera.pose import pose_from_angles
from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

FIELD_DEG = (120.0, 220.0)
"""Least and greatest field of view of a lens, from rim to rim."""
HEIGHT_M = (0.5, 2.5)
"""Least and greatest height of a rig above the road."""
RADIUS_M = (0.2, 1.6)
"""Least and greatest distance of the cameras of a ring from its centre."""
COUNTS = (2, 3, 4, 5, 6, 8)
"""Numbers of cameras of a ring; 7 is left for tests on unseen rigs."""
LENSES = ("equidistant", "kannala_brandt", "double_sphere", "eucm", "mei", "radial_polynomial")
"""Models of the lenses; `ocam` is left for tests on unseen rigs."""
PINHOLE_DEG = 130.0
"""Greatest field of view of a pinhole camera."""
MISSING = 0.15
"""Probability that a rig of more than two cameras lacks one of them."""

NARROW_DEG = (50.0, 90.0)
"""Least and greatest field of view of the narrow cameras of `draw_any_rig`."""
TALL_M = (1.8, 3.2)
"""Least and greatest height of the cameras of a truck or bus above the road."""

RANDOM, ANY = "random", "any"
"""Names of rigs that are drawn anew for every scene, by `draw_rig` and `draw_any_rig`."""
VERSION = 1
"""Raised when the code draws other rigs, so that scenes are rendered anew."""

Origin = float | Literal["drawn"] | None
"""Height of the ego origin above the road, m, of every scene; `drawn`: another one in each; None: that of the rig."""
DRAWN = "drawn"
HIGHEST_M = 10.0
"""Greatest height of the ego origin above the road."""
GRID_M = 2.2
"""Height above the road of the origin of most voxel grids."""

Place = tuple[tuple[float, float, float], float, float, float]
"""Position (m), yaw, pitch and roll (degrees) of a camera, see `pose_from_angles`."""
Draw = np.random.Generator


def draw_rig(rng: Draw, pixels: int) -> Rig:
    """Return a rig whose images have about this many pixels; it says how high the road is below its origin.

    Half are rings of outward cameras, the others look like those of cars (bumpers and mirrors) or of small robots.
    """
    kind = rng.choice(3, p=(0.5, 0.25, 0.25))
    height_m = float(rng.uniform(*HEIGHT_M))
    if kind == 0:
        places = ring_places(rng, int(rng.choice(COUNTS)), _log_uniform(rng, *RADIUS_M))
    elif kind == 1:
        places, height_m = car_places(rng), float(rng.uniform(0.6, 1.2))
    else:
        places = ring_places(rng, int(rng.choice((2, 3, 4))), _log_uniform(rng, 0.1, 0.4))
    if len(places) > 2 and rng.uniform() < MISSING:
        places.pop(int(rng.integers(len(places))))
    return rig_at(rng, places, str(rng.choice((*LENSES, "pinhole"), p=_LENS_P)), pixels, -height_m)


def draw_any_rig(rng: Draw, pixels: int) -> Rig:
    """Return a rig as `draw_rig` does, or one of those with less overlap or height in common: what people have.

    Half are rigs of `draw_rig`. The others are rings of narrow cameras, pairs and single cameras that look ahead, and
    trucks and buses.
    """
    kind = rng.choice(("drawn", "narrow", "pair", "single", "truck"), p=(0.5, 0.15, 0.15, 0.1, 0.1))
    if kind == "drawn":
        return draw_rig(rng, pixels)
    if kind == "truck":
        return rig_at(rng, truck_places(rng), _fisheye(rng), pixels, -float(rng.uniform(*TALL_M)))
    narrow = kind == "narrow" or rng.uniform() < 0.7
    lens, field_deg = ("pinhole", NARROW_DEG) if narrow else (_fisheye(rng), FIELD_DEG)
    height_m = float(rng.uniform(0.6, 2.2))
    if kind == "narrow":
        places = ring_places(rng, int(rng.choice((4, 5, 6, 7))), _log_uniform(rng, 0.2, 1.2), (-8, 4), upright=True)
    else:
        places = ahead_places(rng, 2 if kind == "pair" else 1)
    return rig_at(rng, places, lens, pixels, -height_m, field_deg)


def _fisheye(rng: Draw) -> str:
    return str(rng.choice(LENSES))


def check_origin(above_m: Origin) -> Origin:
    """Return the height of an origin as a number, `drawn` or None; raise ValueError for any other value."""
    if above_m is None or above_m == DRAWN:
        return above_m
    if not 0 < float(above_m) <= HIGHEST_M:
        raise ValueError(f"origin_above_road_m is {above_m}; it must be above 0 and at most {HIGHEST_M:g}, or {DRAWN}")
    return float(above_m)


def draw_origin(rng: Draw, rig_m: float) -> float:
    """Return a height above the road, m: a third each at `rig_m`, between, and at the height of most voxel grids."""
    share = min(max(float(rng.uniform(-1, 2)), 0.0), 1.0)
    return rig_m + share * (GRID_M - rig_m)


_LENS_P = (*(0.95 / len(LENSES),) * len(LENSES), 0.05)


def rig_at(
    rng: Draw,
    places: list[Place],
    lens: str,
    pixels: int,
    road_z_m: float,
    field_deg: tuple[float, float] = FIELD_DEG,
) -> Rig:
    """Return cameras of one kind at the given places; field of view (between two limits) and image size are drawn."""
    field = float(rng.uniform(*field_deg))
    aspect = float(rng.choice((1.0, 4 / 3, 3 / 2, 16 / 9)))
    width = 8 * round(math.sqrt(pixels * aspect) / 8)
    height = 8 * round(math.sqrt(pixels / aspect) / 8)
    fill = float(rng.uniform(0.85, 1.2))
    cameras = tuple(draw_lens(rng, lens, width, height, field, fill) for _ in places)
    poses = torch.stack([pose_from_angles(*place) for place in places])
    return Rig(cameras, poses, tuple(f"camera{k}" for k in range(len(places))), None, road_z_m)


def ring_places(
    rng: Draw, count: int, radius_m: float, pitch_deg: tuple[float, float] = (-30, 10), upright: bool = False
) -> list[Place]:
    """Return cameras around a centre that look outwards, unevenly spaced.

    Unless they are `upright`, some hang upside down or on their side.
    """
    azimuths_deg = 360 * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count + rng.uniform(0, 360)
    pitch, tilt = rng.uniform(*pitch_deg), rng.choice((0.0, 180.0, 90.0), p=(0.85, 0.1, 0.05))
    tilt = 0.0 if upright else tilt
    places = []
    for azimuth_deg in azimuths_deg.tolist():
        radius = radius_m * float(rng.uniform(0.8, 1.2))
        turn = math.radians(azimuth_deg)
        at_m = radius * math.cos(turn), radius * math.sin(turn), float(rng.normal(0, 0.05))
        angles = rng.normal((azimuth_deg, pitch, tilt), (5.0, 4.0, 2.0)).tolist()
        places.append((at_m, *angles))
    return places


def car_places(rng: Draw) -> list[Place]:
    """Return cameras at bumper, mirrors and boot lid of a car, looking down to the road beside it."""
    ahead_m, back_m, side_m = rng.uniform((2.33, 2.33, 0.98), (2.7, 2.7, 1.15)).tolist()
    mirror_m, height_m = float(rng.uniform(0.3, 1.1)), rng.normal(0, 0.1, 4).tolist()
    pitch_deg = rng.uniform((-40, -60, -40, -60), (-10, -20, -10, -20)).tolist()
    at_m = [(ahead_m, 0.0), (mirror_m, side_m), (-back_m, 0.0), (mirror_m, -side_m)]
    return [
        ((x, y, z), yaw + float(rng.normal(0, 4)), pitch, float(rng.normal(0, 2)))
        for (x, y), z, yaw, pitch in zip(at_m, height_m, (0.0, 90.0, 180.0, -90.0), pitch_deg, strict=True)
    ]


def truck_places(rng: Draw) -> list[Place]:
    """Return cameras at the four sides of a truck or bus, two on each long side of half of them."""
    half_m, side_m = float(rng.uniform(2.5, 6.0)), float(rng.uniform(1.1, 1.35))
    along_m = (half_m / 2, -half_m / 2) if rng.uniform() < 0.5 else (float(rng.uniform(-0.5, 0.8)) * half_m,)
    pitch_deg = float(rng.uniform(-50, -15))
    at_m = [(half_m, 0.0, 0.0), (-half_m, 0.0, 180.0)]
    at_m += [(x, side * side_m, side * 90.0) for side in (1, -1) for x in along_m]
    return [
        ((x, y, float(rng.normal(0, 0.1))), *rng.normal((yaw, pitch_deg, 0.0), (4.0, 5.0, 2.0)).tolist())
        for x, y, yaw in at_m
    ]


def ahead_places(rng: Draw, count: int) -> list[Place]:
    """Return cameras side by side that look ahead."""
    baseline_m, ahead_m = _log_uniform(rng, 0.1, 0.8), float(rng.uniform(-0.3, 1.5))
    pitch_deg = float(rng.uniform(-12, 4))
    spread_m = np.linspace(baseline_m / 2, -baseline_m / 2, count) if count > 1 else np.zeros(1)
    return [
        ((ahead_m, y, 0.0), *rng.normal((0.0, pitch_deg, 0.0), (1.0, 0.5, 0.5)).tolist()) for y in spread_m.tolist()
    ]


def draw_lens(rng: Draw, lens: str, width: int, height: int, field_deg: float, fill: float) -> Camera:
    """Return a camera with plausible distortion; the rim of its field lies at `fill` times half the image's width.

    Raises:
        ValueError: if there is no such lens.
    """
    if lens not in _DRAW:
        raise ValueError(f"there is no lens '{lens}'; choose one of {', '.join(_DRAW)}")
    half_deg = min(field_deg, PINHOLE_DEG if lens == "pinhole" else 360.0) / 2
    rim = math.radians(half_deg)
    ray = torch.tensor([math.sin(rim * 0.9999), 0.0, math.cos(rim * 0.9999)], dtype=torch.float64)
    center = tuple((np.array((width, height)) * rng.normal(0.5, 0.012, 2) - 0.5).tolist())
    while True:
        shape = _DRAW[lens](rng, half_deg)
        radius_px, seen = shape(1000.0, (1e6, 1e6), 2_000_001, 2_000_001).project(ray)
        if bool(seen):
            focal_px = 1000 * fill * width / 2 / float(radius_px[0] - 1e6)
            return shape(focal_px, center, width, height)


def perturb_rig(rng: Draw, rig: Rig, angle_deg: float = 0.1, distance_m: float = 0.003) -> Rig:
    """Return the rig with poses that are wrong as calibrations are, by these standard deviations about each axis."""
    poses = rig.ego_from_camera.clone()
    for pose in poses:
        pose[:3, :3] = pose[:3, :3] @ _small_rotation(np.radians(rng.normal(0, angle_deg, 3)))
        pose[:3, 3] += torch.from_numpy(rng.normal(0, distance_m, 3))
    return replace(rig, ego_from_camera=poses)


def _small_rotation(vector_rad: np.ndarray) -> Float64[Tensor, "3 3"]:
    x, y, z = vector_rad.tolist()
    return torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64))


def _log_uniform(rng: Draw, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


Shape = Callable[[float, tuple[float, float], int, int], Camera]


def _equidistant(rng: Draw, half_deg: float) -> Shape:
    return lambda focal, center, w, h: Equidistant(w, h, float(focal), center, half_deg)


def _pinhole(rng: Draw, half_deg: float) -> Shape:
    return lambda focal, center, w, h: Pinhole(w, h, (focal, focal), center)


def _kannala_brandt(rng: Draw, half_deg: float) -> Shape:
    bends = (*rng.normal(0, (0.03, 0.008, 0.002)).tolist(), 0.0)
    return lambda focal, center, w, h: KannalaBrandt(w, h, (focal, focal), center, bends, half_deg)


def _double_sphere(rng: Draw, half_deg: float) -> Shape:
    xi, alpha = rng.uniform((-0.3, 0.52), (0.1, 0.66)).tolist()
    return lambda focal, center, w, h: DoubleSphere(w, h, (focal, focal), center, xi, alpha, max_angle_deg=half_deg)


def _eucm(rng: Draw, half_deg: float) -> Shape:
    alpha, beta = rng.uniform((0.55, 0.9), (0.75, 1.6)).tolist()
    return lambda focal, center, w, h: EUCM(w, h, (focal, focal), center, alpha, beta, max_angle_deg=half_deg)


def _mei(rng: Draw, half_deg: float) -> Shape:
    xi, bends = float(rng.uniform(1.0, 2.4)), (*rng.normal(0, (0.02, 0.01, 0.0005, 0.0005)).tolist(),)
    return lambda focal, center, w, h: MEI(w, h, (focal, focal), center, xi, bends, max_angle_deg=half_deg)


def _radial_polynomial(rng: Draw, half_deg: float) -> Shape:
    bends = (1.0, *rng.normal(0, (0.03, 0.03, 0.01)).tolist())
    return lambda focal, center, w, h: RadialPolynomial(
        w, h, tuple(focal * bend for bend in bends), center, 1.0, half_deg
    )


def _ocam(rng: Draw, half_deg: float) -> Shape:
    bend = float(rng.normal(0, 0.02))

    def shape(focal: float, center: tuple[float, float], w: int, h: int) -> Camera:
        theta = np.linspace(0.01, math.radians(half_deg), 200)
        rho = focal * (theta + bend * theta**3)
        powers = np.stack([rho**0, rho**2, rho**3, rho**4], 1) / focal ** np.array([0, 2, 3, 4])
        factors = np.linalg.lstsq(powers, -rho / np.tan(theta) / focal, rcond=None)[0]
        a0, a2, a3, a4 = (factors * focal / focal ** np.array([0, 2, 3, 4])).tolist()
        return OCam(w, h, center, (a0, 0.0, a2, a3, a4), (), (1.0, 0.0, 0.0), max_angle_deg=half_deg)

    return shape


_DRAW: dict[str, Callable[[Draw, float], Shape]] = {
    "equidistant": _equidistant,
    "pinhole": _pinhole,
    "kannala_brandt": _kannala_brandt,
    "double_sphere": _double_sphere,
    "eucm": _eucm,
    "mei": _mei,
    "radial_polynomial": _radial_polynomial,
    "ocam": _ocam,
}

DRAWING: dict[str, Callable[[Draw, int], Rig]] = {RANDOM: draw_rig, ANY: draw_any_rig}
"""What draws the rig of a scene, by the name of the rig."""
