"""What looks wrong about a rig before anything is predicted with it: its poses, its road, its lenses, its overlap."""

import math
import re
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.camera.models.equirectangular import Equirectangular
from omniocc.camera.models.panoramic import Panoramic
from omniocc.camera.parallax import shared_view
from omniocc.camera.pose import LEVEL_FORWARD, angles_of
from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

STEPS = 1024
"""Steps in which a row or a column of an image is followed."""
STEEP_DEG = 65.0
"""Largest pitch, up or down, that is usual; cameras in the mirrors of cars look up to 60 degrees down."""
FACING_DEG = 15.0
"""Angle between an axis and the direction to another camera, up to which it looks at that camera."""
SAME_M, SAME_RAD = 0.01, 0.02
"""Distance and angle up to which two poses are the same."""
DIRECTIONS = {"front": (1, 0), "rear": (-1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
"""Words in the names of cameras, and forward and left of where they look."""
OFF_NAME_DEG = 75.0
"""Angle between the yaw of a camera and the direction in its name that is usual: a corner may look to a side."""
OFF_CENTER = 0.1
"""Distance of the optical axis from the middle of the image, over its width or height, that is usual."""
ENDS_DEG = 2.0
"""Angle that the last pixel with a ray may be short of the end of the lens."""
WIDE_M = 25.0
"""Largest distance between two cameras of a vehicle."""
HIGH_M = 6.0
"""Height above the road of the lowest camera of a vehicle, at most."""
TRAINED = 8
"""Most cameras of the rigs that networks for any rig are trained on."""
AROUND = Equirectangular(120, 50, 60.0, -90.0)
NARROW_DEG = 100.0
"""Horizontal field of view up to which a camera is called narrow."""
AHEAD_DEG = 60.0
"""Angle between axes and their mean up to which cameras look the same way."""
RANGES_M = (2.0, 8.0, 64.0)
"""Directions and ranges at which cameras may see the same."""

Line = tuple[Float64[Tensor, "S 2"], Float64[Tensor, "S 3"], Bool[Tensor, " S"]]


class Field(NamedTuple):
    """What a camera sees along the row and the column through its optical axis.

    Attributes:
        horizontal_deg: angle along the row.
        vertical_deg: angle along the column.
        px_per_deg: pixels per degree along the row, a mean.
        end_deg: angle from the axis at which the image has no rays any more; None where it has them up to its edges.
    """

    horizontal_deg: float
    vertical_deg: float
    px_per_deg: float
    end_deg: float | None


def field_of(camera: Camera) -> Field:
    """Return the field of view of a camera; masks do not matter."""
    lines = cross(camera)
    horizontal_deg, vertical_deg = (_angle_deg(rays, seen) for _, rays, seen in lines)
    width_px = float(lines[0][2].double().mean()) * camera.width
    from_axis_deg = [torch.rad2deg(rays[seen][:, 2].clamp(-1, 1).acos()) for _, rays, seen in lines if seen.any()]
    ends = [float(angles.max()) for angles in from_axis_deg] if not all(seen.all() for *_, seen in lines) else []
    density = width_px / horizontal_deg if horizontal_deg else 0.0
    return Field(horizontal_deg, vertical_deg, density, max(ends, default=None))


def kind_of(rig: Rig) -> str:
    """Return what kind of rig it is: one camera, or several, narrow or wide, that look the same way or around."""
    if len(rig.cameras) == 1:
        return "one camera"
    axes = rig.ego_from_camera[:, :3, 2]
    cosines = axes @ torch.nn.functional.normalize(axes.mean(0), dim=0)
    where = "ahead" if cosines.min() >= math.cos(math.radians(AHEAD_DEG)) else "around"
    lens = "wide" if max(field_of(camera).horizontal_deg for camera in rig.cameras) > NARROW_DEG else "narrow"
    return f"{lens} cameras {where}"


def _angle_deg(rays: Float64[Tensor, "S 3"], seen: Bool[Tensor, " S"]) -> float:
    chords = (rays[1:] - rays[:-1]).norm(dim=-1)[seen[1:] & seen[:-1]]
    return math.degrees(float(2 * (chords / 2).clamp(max=1).asin().sum()))


def cross(camera: Camera) -> tuple[Line, Line]:
    """Return pixels, their rays in the camera frame, and where there are any: of the row and column of the axis."""
    axis = camera.project(torch.tensor([0.0, 0, 1], dtype=torch.float64))[0].tolist()
    lines = []
    for along, size in enumerate((camera.width, camera.height)):
        other = (camera.height, camera.width)[along]
        pixels = torch.full((STEPS + 1, 2), min(max(axis[1 - along], 0.0), other - 1.0), dtype=torch.float64)
        pixels[:, along] = torch.linspace(-0.5, size - 0.5, STEPS + 1, dtype=torch.float64)
        lines.append((pixels, *camera.unproject(pixels)))
    return lines[0], lines[1]


def suspicious(rig: Rig) -> list[str]:
    """Return a line for everything about a rig that is probably a mistake, or that limits what it can measure.

    All of it is allowed: a rig with lines can be used. No images are needed.
    """
    lines = [*_count(rig), *_tilted(rig), *_turned(rig), *_facing(rig), *_same(rig), *_road(rig), *_lenses(rig)]
    points = torch.tensor(RANGES_M)[:, None, None, None] * AROUND.rays()
    if len(rig.cameras) > 1 and shared_view(rig, points) == 0:
        lines.append("no two cameras see the same: ranges are guessed from single images")
    return lines


def _count(rig: Rig) -> Iterator[str]:
    count, positions = len(rig.cameras), rig.ego_from_camera[:, :3, 3]
    if count == 1:
        yield "one camera: it is allowed, but ranges are guessed from a single image"
    if count > TRAINED:
        yield f"{count} cameras: they are allowed, but networks for any rig are trained with 2 to {TRAINED}"
    if (apart_m := float(torch.cdist(positions, positions).max())) > WIDE_M:
        yield f"cameras are up to {apart_m:,.0f} m apart: are the positions in metres?"


def _tilted(rig: Rig) -> Iterator[str]:
    """Yield what is said about cameras that look at sky or ground or lie on their side, with a frame that cures it."""
    angles = [angles_of(pose) for pose in rig.ego_from_camera]
    cases = {
        "at the sky": [pitch > STEEP_DEG for _, pitch, _ in angles],
        "at the ground": [pitch < -STEEP_DEG for _, pitch, _ in angles],
        "sideways up or down, as they lie on their side": [
            45 < abs(roll) < 135 and abs(pitch) <= STEEP_DEG for _, pitch, roll in angles
        ],
    }
    found = [f"{_named(rig, case)} {where}" for where, case in cases.items() if any(case)]
    if found:
        yield f"{'; '.join(found)}{_remedy(rig)}"


def _remedy(rig: Rig) -> str:
    """Return which other convention of poses would make all cameras upright and level; empty if none would."""
    rotations = rig.ego_from_camera[:, :3, :3]
    others = {
        "is ego_from_camera inverted?": rotations.transpose(1, 2),
        "is it the pose of a frame with x forward, z up? A camera has x right, y down, z forward": (
            rotations @ torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
        ),
    }
    for question, turned in others.items():
        if all(abs(pitch) < 45 and abs(roll) < 30 for _, pitch, roll in map(angles_of, turned)):
            return f": {question}"
    return ""


def _turned(rig: Rig) -> Iterator[str]:
    """Yield a line for cameras that look elsewhere than their names say, if one is called front, rear or back."""
    named = {k: re.findall("|".join(DIRECTIONS), name.lower()) for k, name in enumerate(rig.names)}
    if not any({"front", "rear", "back"} & set(words) for words in named.values()):
        return  # the left and the right camera of a stereo pair look forward
    for k, words in named.items():
        forward, left = (sum(DIRECTIONS[word][axis] for word in words) for axis in range(2))
        yaw_deg, pitch_deg, _ = angles_of(rig.ego_from_camera[k])
        off_deg = (yaw_deg - math.degrees(math.atan2(left, forward)) + 180) % 360 - 180
        if (forward or left) and abs(pitch_deg) < STEEP_DEG and abs(off_deg) > OFF_NAME_DEG:
            side = "left" if off_deg > 0 else "right"
            yield f"camera '{rig.names[k]}' looks {abs(off_deg):.0f} degrees to the {side} of what its name says"


def _facing(rig: Rig) -> Iterator[str]:
    positions, axes = rig.ego_from_camera[:, :3, 3], rig.ego_from_camera[:, :3, 2]
    inward = positions.mean(0) - positions
    if len(positions) > 2 and bool(((axes * inward)[:, :2].sum(-1) > 0.7 * inward[:, :2].norm(dim=-1)).all()):
        yield "all cameras look to the middle of the rig: are their yaws wrong by 180 degrees?"
        return
    pairs = []
    for one, other in combinations(range(len(positions)), 2):
        sight = positions[other] - positions[one]
        least = math.cos(math.radians(FACING_DEG)) * float(sight.norm())
        if least > SAME_M and float(axes[one] @ sight) > least and float(axes[other] @ -sight) > least:
            pairs.append(f"'{rig.names[one]}' and '{rig.names[other]}'")
    if pairs:
        yield f"cameras look into each other: {', '.join(pairs)}; is a yaw wrong by 180 degrees?"


def _same(rig: Rig) -> Iterator[str]:
    for one, other in combinations(range(len(rig.names)), 2):
        difference = rig.ego_from_camera[one] - rig.ego_from_camera[other]
        if float(difference[:3, 3].norm()) < SAME_M and float(difference[:3, :3].abs().max()) < SAME_RAD:
            yield f"cameras '{rig.names[one]}' and '{rig.names[other]}' have the same pose: is one a copy of the other?"


def _road(rig: Rig) -> Iterator[str]:
    if rig.road_z_m is None:
        yield "the height of the road is not known: write road_z_m into the rig file (-0.9: 0.9 m below the origin)"
    yield from wrong_road(rig)


def wrong_road(rig: Rig) -> Iterator[str]:
    """Yield a line if a stated height of the road cannot be: above a camera, or far below all of them."""
    if rig.road_z_m is None:
        return
    heights_m = rig.ego_from_camera[:, 2, 3] - rig.road_z_m
    lowest_m = float(heights_m.min())
    if lowest_m <= 0:
        below = _named(rig, (heights_m <= 0).tolist())
        yield f"the road (road_z_m: {rig.road_z_m:g}) is above {below}, by up to {-lowest_m:.2g} m: is z up?"
    elif lowest_m > HIGH_M:
        yield f"the road (road_z_m: {rig.road_z_m:g}) is {lowest_m:.1f} m below the lowest camera: is it in metres?"


def _lenses(rig: Rig) -> Iterator[str]:
    yield from lenses_that_do_not_fit(rig)
    for name, camera in zip(rig.names, rig.cameras, strict=True):
        end_deg, lens_deg = field_of(camera).end_deg, getattr(camera, "max_angle_deg", 180.0)
        if end_deg is not None and lens_deg < 180 and end_deg < lens_deg - ENDS_DEG:
            yield (
                f"camera '{name}': its lens model ends {end_deg:.0f} degrees off the axis, inside of the image, but "
                f"max_angle_deg is {lens_deg:g}"
            )
        axis, seen = camera.project(torch.tensor([0.0, 0, 1], dtype=torch.float64))
        middle = torch.tensor([camera.width - 1, camera.height - 1], dtype=torch.float64) / 2
        off = (axis - middle).abs() / torch.tensor([camera.width, camera.height])
        if not isinstance(camera, Panoramic) and (not bool(seen) or bool((off > OFF_CENTER).any())):
            yield (
                f"camera '{name}': its optical axis is at ({axis[0]:.0f}, {axis[1]:.0f}) px, far from the middle "
                f"({middle[0]:.0f}, {middle[1]:.0f}): is the calibration of another size, or cropped?"
            )


def _named(rig: Rig, chosen: list[bool]) -> str:
    """Return in words which cameras are chosen."""
    if all(chosen):
        return "all cameras" if len(chosen) > 1 else "the camera"
    return "camera " + ", ".join(f"'{name}'" for name, one in zip(rig.names, chosen, strict=True) if one)
