"""The parts of a robustness test: disturbances by name, with strength and unit in the name."""

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from omniocc.camera import Rig
from omniocc.camera.masks import drop_random_cameras, mask_cameras, mask_view
from omniocc.camera.miscalibrated import move_cameras, scale_focal_lengths, turn_cameras
from omniocc.data.augment.degrade import Image, blur, change_exposure, compress_jpeg
from omniocc.errors import UserError
from omniocc.extras.robustness import disturbance as kinds
from omniocc.extras.robustness.disturbance import Disturbance
from omniocc.runs.folder import short_hash
from omniocc.runs.robustness import UNDISTURBED
from omniworld.render.weather import WEATHERS
from omniworld.variations.night import NIGHT

VERSION = 1
"""Raise it when code changes what a disturbance does, so that finished parts are computed anew."""

VIEW_DEG = (270, 180, 90)
EXTRINSICS_DEG = (0.1, 0.3, 1, 3)
EXTRINSICS_CM = (1, 3, 10)
FOCAL_PERCENT = (1, 3, 10)
LATE_MS = (50, 100, 200)
STOPS = {1: "1_stop", 2: "2_stops"}
NOISE_PERCENT = (2, 5, 10)
BLUR_PX = (0.5, 1, 2)
JPEG_QUALITY = (50, 20, 5)
LENS_PERCENT = (20, 60)
ON_ONE_LENS = {"drops_on_one_lens": kinds.drops_on_one_lens, "dirt_on_one_lens": kinds.dirt_on_one_lens}


class Part(NamedTuple):
    """One part of the test.

    Attributes:
        name: with strength and unit.
        group: kind of disturbance.
        disturbance: of the recorded frames.
        source: other options of `data.source`, with which the test scenes are rendered anew.
    """

    name: str
    group: str
    disturbance: Disturbance = Disturbance()
    source: Mapping[str, Any] = MappingProxyType({})

    @property
    def options(self) -> str:
        """Return a hash of the other options of the source: equal for parts that are tested on the same frames."""
        return short_hash(dict(self.source))


def parts_of(cameras: Sequence[str], unseen: Sequence[str]) -> list[Part]:
    """Return all parts, the undisturbed one first.

    Args:
        cameras: names of the cameras, each of which is dropped once.
        unseen: kinds of places that the checkpoint was not trained on.
    """
    return [
        Part(UNDISTURBED, UNDISTURBED),
        *camera_parts(cameras),
        *calibration_parts(),
        *image_parts(),
        *world_parts(unseen),
    ]


def camera_parts(cameras: Sequence[str]) -> list[Part]:
    """Return the parts in which less is seen, as the system knows: dropped cameras, narrower views."""
    dropped = [
        Part(f"camera_{name}_dropped", "camera_dropped", Disturbance(partial(_rig, change=_dropped(name))))
        for name in cameras
        if len(cameras) > 1
    ]
    if len(cameras) > 2:
        two = Disturbance(partial(drop_random_cameras, count=2))
        dropped.append(Part("two_cameras_dropped", "two_cameras_dropped", two))
    views = [
        Part(f"view_{deg}_deg", "view", Disturbance(partial(_rig, change=partial(mask_view, view_deg=float(deg)))))
        for deg in VIEW_DEG
    ]
    return [*dropped, *views]


def calibration_parts() -> list[Part]:
    """Return the parts in which poses and focal lengths are not what the system believes."""
    kinds_of = {
        "extrinsics_{:g}_deg": ("extrinsics_deg", turn_cameras, "angle_deg", EXTRINSICS_DEG, 1.0),
        "extrinsics_{:g}_cm": ("extrinsics_cm", move_cameras, "distance_m", EXTRINSICS_CM, 0.01),
        "focal_{:g}_percent": ("focal", scale_focal_lengths, "percent", FOCAL_PERCENT, 1.0),
    }
    return [
        Part(name.format(strength), group, Disturbance(partial(change, **{argument: strength * unit})))
        for name, (group, change, argument, strengths, unit) in kinds_of.items()
        for strength in strengths
    ]


def image_parts() -> list[Part]:
    """Return the parts with worse images."""
    return [
        *(
            _each_image(f"exposure_{name}_under", "exposure", partial(change_exposure, stops=-n))
            for n, name in STOPS.items()
        ),
        *(
            _each_image(f"exposure_{name}_over", "exposure", partial(change_exposure, stops=n))
            for n, name in STOPS.items()
        ),
        *(
            Part(f"noise_{n}_percent", "noise", Disturbance(images=partial(kinds.noise, percent=n), each_frame=True))
            for n in NOISE_PERCENT
        ),
        *(_each_image(f"blur_{px:g}_px", "blur", partial(blur, sigma_px=px)) for px in BLUR_PX),
        *(_each_image(f"jpeg_quality_{n}", "jpeg", partial(compress_jpeg, quality=n)) for n in JPEG_QUALITY),
        *(
            Part(f"{name}_{n}_percent", name, Disturbance(images=partial(change, percent=n)))
            for name, change in ON_ONE_LENS.items()
            for n in LENS_PERCENT
        ),
    ]


def world_parts(unseen: Sequence[str]) -> list[Part]:
    """Return the parts whose frames the virtual world renders anew: late cameras, weather, night, other places."""
    late = [Part(f"camera_late_{ms}_ms", "camera_late", source={"late_camera_ms": float(ms)}) for ms in LATE_MS]
    weathers = [Part(f"weather_{name}", "weather", source={"weather": name}) for name in WEATHERS]
    parts = [*late, *weathers, Part(NIGHT, NIGHT, source={"weather": NIGHT})]
    if unseen:
        places = {"themes": list(unseen), "test_places": []}
        parts.append(Part(UNSEEN, UNSEEN, source=places))
    return parts


UNSEEN = "places_never_trained_on"
NO_UNSEEN = (
    f"{UNSEEN}: this checkpoint was trained on all of its places; train another with data.source.test_places=[...], "
    "which leaves some out"
)


def chosen(wanted: Sequence[str], parts: Sequence[Part]) -> list[Part]:
    """Return the undisturbed part and those that were asked for, in their order.

    Args:
        wanted: `all`, or names of parts or of groups.
        parts: all there are, the undisturbed one first.

    Raises:
        UserError: naming the nearest names of a part that does not exist.
    """
    known = list(dict.fromkeys(["all", *(part.group for part in parts[1:]), *(part.name for part in parts[1:])]))
    for name in wanted:
        if name == UNSEEN and name not in known:
            raise UserError(NO_UNSEEN)
        if name not in known:
            close = get_close_matches(name, known[1:], n=3, cutoff=0.5)
            groups = ", ".join(dict.fromkeys(part.group for part in parts[1:]))
            hint = f"; did you mean {' or '.join(close)}?" if close else ""
            raise UserError(f"robustness={name}: there is no such part{hint}\n  all, or some of: {groups}")
    return [part for part in parts if part.group == UNDISTURBED or {"all", part.group, part.name} & set(wanted)]


def _each_image(name: str, group: str, change: Callable[[Image], Image]) -> Part:
    return Part(name, group, Disturbance(images=partial(kinds.every_image, change=change)))


def _rig(rig: Rig, rng: np.random.Generator, change: Callable[[Rig], Rig]) -> Rig:
    """Return a rig changed without any random draw."""
    del rng
    return change(rig)


def _dropped(name: str) -> Callable[[Rig], Rig]:
    return partial(mask_cameras, names=(name,))
