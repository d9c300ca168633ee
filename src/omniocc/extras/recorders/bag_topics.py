"""Which topics of a bag belong to which camera, and what the poses are: stated in a file, or guessed by their names."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from omniocc.camera.protocol import is_finite
from omniocc.errors import UserError, in_line, repr_of
from omniocc.io import read_yaml
from omniocc.predict.input.images import suggest_name

GUESS = "guess"
FILLERS = frozenset(
    [
        "cam",
        "camera",
        "cameras",
        "color",
        "colour",
        "compressed",
        "driver",
        "image",
        "images",
        "raw",
        "rect",
        "rgb",
        "sensing",
        "sensor",
        "sensors",
    ]
)
"""Words of topics and cameras that name no place on the car."""
COMPRESSED = "/compressed"
RAW = "image_raw"
BASES = ("base_link", "base_footprint", "base", "rear_axle", "vehicle", "ego")
WORLDS = ("odom", "map", "world")
"""Usual names of the frame of the vehicle and of fixed frames; the first that a bag has is taken."""


@dataclass(frozen=True)
class Topics:
    """Content of the file `topics=...`; its keys are those of `conf/recorder/bag.yaml`.

    Attributes:
        cameras: topic of the images of each camera; None: guessed.
        camera_info: topic of the CameraInfo of each camera, without a rig; None: `camera_info` beside the images.
        poses: topic, or `tf`; None: none; `guess`: tf, or the only topic of poses.
        base_frame: name in tf of the frame of the vehicle; None: the first of `BASES` that tf has.
        world_frame: name in tf; None: the first of `WORLDS` that tf has.
        ego_from_base: pose of the frame of the vehicle in the frame of the rig; None: they are the same.
        reference: see `omniocc.extras.recorders.log.Timing`, as `limit_s`, `interval_s` and `pose_gap_s`.
    """

    cameras: Mapping[str, str] | None = None
    camera_info: Mapping[str, str] | None = None
    poses: str | None = GUESS
    base_frame: str | None = None
    world_frame: str | None = None
    ego_from_base: Any = None
    reference: str | None = None
    limit_s: float = 0.05
    interval_s: float | None = None
    pose_gap_s: float = 1.0


def stated_topics(path: Path | None) -> Topics:
    """Return the content of a file; one whose keys are not those of `Topics` holds the topics of cameras alone.

    Raises:
        UserError, DataError: naming the file, and the key that is unknown or of the wrong type.
    """
    if path is None:
        return Topics()
    content = read_yaml(path)
    if not isinstance(content, Mapping) or not content:
        raise UserError(
            f"topics={path}: it holds no mapping; write a line for each camera, such as front: /front/image"
        )
    if not set(content) & set(KINDS):
        content = {"cameras": content}
    for key, value in content.items():
        if key not in KINDS:
            known = suggest_name(str(key), KINDS) or f"; keys: {', '.join(KINDS)}"
            raise UserError(f"topics={path}: there is no key '{key}'{known}")
        if problem := KINDS[key](value):
            raise UserError(f"topics={path}: {key} is {repr_of(value)}; it must be {problem}")
    values: dict[str, Any] = dict(content)
    return Topics(**values)


def _names(value: Any) -> str:
    whole = (
        isinstance(value, Mapping) and value and all(isinstance(text, str) for pair in value.items() for text in pair)
    )
    return "" if whole else "a mapping of the names of cameras to topics"


def _text(value: Any) -> str:
    return "" if value is None or isinstance(value, str) else "a name"


def _seconds(value: Any) -> str:
    return "" if is_finite(value) and value > 0 else "a time in s, above 0"


KINDS: dict[str, Callable[[Any], str]] = {
    "cameras": _names,
    "camera_info": _names,
    "poses": _text,
    "base_frame": _text,
    "world_frame": _text,
    "ego_from_base": lambda _: "",  # checked where it is read
    "reference": _text,
    "limit_s": _seconds,
    "interval_s": lambda value: "" if value is None else _seconds(value),
    "pose_gap_s": _seconds,
}
"""The keys of the file; each function returns what a value must be, or nothing if it is that."""


def words_of(text: str) -> tuple[str, ...]:
    """Return the words and numbers of a name, without `FILLERS`; all of them if nothing else is left."""
    words = re.findall(r"[a-z]+|\d+", text.lower())
    return tuple(word for word in words if word not in FILLERS) or tuple(words)


def fits(camera: str, topic: str) -> bool:
    """Return whether a part of a topic, or all of it, names a camera: `/camera/front_left/image_raw`, `front_left`."""
    return words_of(camera) in (words_of(topic), *(words_of(part) for part in topic.strip("/").split("/")))


def distinct(topics: Iterable[str]) -> list[str]:
    """Return topics of images without those that hold the compressed images of another."""
    found = set(topics)
    return sorted(
        topic for topic in found if topic.removesuffix(COMPRESSED) == topic or topic[: -len(COMPRESSED)] not in found
    )


def guess_cameras(cameras: Sequence[str], topics: Iterable[str], place: str) -> dict[str, str]:
    """Return the topic of images of each camera of a rig; of several in one place, `image_raw`.

    Args:
        cameras: their names.
        topics: of images.
        place: the bag, for messages.

    Raises:
        UserError: naming the camera that has no topic, or several.
    """
    have, result = distinct(topics), {}
    for camera in cameras:
        found = [topic for topic in have if fits(camera, topic)]
        raw = [topic for topic in found if PurePosixPath(topic.removesuffix(COMPRESSED)).name == RAW]
        found = raw if len(raw) == 1 else found
        if len(have) == len(cameras) == 1:
            found = have
        if len(found) != 1:
            several = f"several topics fit camera '{camera}': {', '.join(found)}"
            nothing = f"no topic of images fits camera '{camera}'; topics of images: {', '.join(have) or 'none'}"
            raise UserError(
                f"{place}: {in_line(several if found else nothing)}; name it in topics=<file> by a line "
                f"'{camera}: /topic', or leave the camera out: exclude_cameras=[{camera}]"
            )
        result[camera] = found[0]
    return result


def info_beside(topic: str) -> str:
    """Return the topic of CameraInfo in the namespace of a topic of images."""
    return f"{topic.removesuffix(COMPRESSED).rpartition('/')[0]}/camera_info"


def guess_names(topics: Iterable[str], infos: Iterable[str]) -> dict[str, str]:
    """Return the topics of images that have CameraInfo beside them, one for each, by the names of their namespaces.

    A name is the last part of the namespace that is no filler; where two have the same, it is the whole namespace.
    """
    chosen: dict[str, str] = {}
    have = set(infos)
    for topic in sorted(distinct(topics), key=lambda one: PurePosixPath(one.removesuffix(COMPRESSED)).name != RAW):
        if info_beside(topic) in have:
            chosen.setdefault(info_beside(topic), topic)
    spaces = {info.rpartition("/")[0]: topic for info, topic in sorted(chosen.items())}
    short = {space: _short(space) for space in spaces}
    unique = len(set(short.values())) == len(short)
    return {short[space] if unique else space.strip("/").replace("/", "_"): topic for space, topic in spaces.items()}


def _short(space: str) -> str:
    parts = [part for part in space.split("/") if part]
    telling = [part for part in parts if set(words_of(part)) - FILLERS]
    return (telling or parts or ["camera"])[-1]


def first_of(wanted: Sequence[str], have: Iterable[str]) -> str | None:
    """Return the first wanted name that is there; None if none is."""
    there = set(have)
    return next((name for name in wanted if name in there), None)
