"""A user's own images, from files or from a ROS bag, as the sequence that the commands predict.

What reads bags needs more packages and shares its code with the recorder of bags, which is above this package
(`omniocc.extras`). So the scripts hand it in as a function.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from omniocc.camera import Rig
from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.errors import UserError
from omniocc.images import Depth
from omniocc.predict.export_scene import RIG
from omniocc.predict.input.images import check_excluded, find_frames, order_line, remarks
from omniocc.predict.input.sequence import ImageSequence, with_road
from omniocc.predict.options import load_rig

SUFFIXES = (".mcap", ".db3", ".bag")
METADATA = "metadata.yaml"
"""File of a folder that is a bag of ROS 2."""


class OwnImages(NamedTuple):
    """Options of a user's own images; see `conf/predict_occupancy.yaml`."""

    images: str | Sequence[str]
    rig: str | None
    road_z_m: float | None
    topics: str | None
    exclude_cameras: Sequence[str]
    image_bits: int | None


class BagImages(NamedTuple):
    """What is asked of a bag.

    Attributes:
        path: file, or folder of ROS 2.
        rig: the cameras; None: those that the bag describes.
        topics: file that names the topics; None: they are guessed.
        excluded: names of the cameras to leave out; their images are black.
        depth: of images with samples in words of 16 bits.
    """

    path: Path
    rig: Rig | None
    topics: Path | None
    excluded: Sequence[str]
    depth: Depth


ReadBag = Callable[[BagImages], AbstractContextManager[ImageSequence]]
"""Opens a bag as a sequence, whose images are read when they are asked for."""


def is_bag(images: str | Sequence[str]) -> bool:
    """Return whether images are in a ROS bag: a file with its suffix, or a folder with its metadata."""
    if not isinstance(images, str):
        return False
    return Path(images).suffix.lower() in SUFFIXES or (Path(images) / METADATA).is_file()


@contextmanager
def own_images(given: OwnImages, read_bag: ReadBag | None) -> Iterator[ImageSequence]:
    """Give the sequence of a user's own images and print what may be wrong with them.

    Raises:
        UserError, DataError: naming the option, file or topic that cannot be used.
    """
    if is_bag(given.images):
        with _bag(given, read_bag) as sequence:
            yield sequence
        return
    if given.topics is not None:
        raise UserError(f"topics={given.topics} belongs to images=<bag>; files have the names of the cameras")
    rig = rig_of(given)
    images = given.images if isinstance(given.images, str) else list(given.images)
    frames = tuple(find_frames(images, rig, given.exclude_cameras, given.image_bits))
    for line in remarks(frames, rig):
        print(line, flush=True)
    yield ImageSequence.of_files(rig, frames)


def rig_of(given: OwnImages) -> Rig:
    """Return the calibrated cameras of image files, with the height of the road that is given beside them.

    Raises:
        UserError: when no rig is given, or it cannot be used.
    """
    if given.rig is None:
        beside = Path(given.images) / RIG if isinstance(given.images, str) else Path(RIG)
        hint = f"; there is {beside}" if beside.is_file() else ""
        raise UserError(f"rig=... is needed: a rig file, a calibration or a built-in rig{hint}")
    return with_road(load_rig(given.rig), given.road_z_m)


@contextmanager
def _bag(given: OwnImages, read_bag: ReadBag | None) -> Iterator[ImageSequence]:
    path = Path(str(given.images))
    if read_bag is None:
        raise UserError(f"images={path}: bags are read by the command src/predict.py alone")
    if not path.exists():
        raise UserError(f"images={path}: there is no such file or folder")
    rig, topics = None if given.rig is None else load_rig(given.rig), given.topics and Path(given.topics)
    if rig is not None:
        check_excluded(given.exclude_cameras, rig)
    depth = Depth(given.image_bits, "image_bits")
    with read_bag(BagImages(path, rig, topics or None, given.exclude_cameras, depth)) as sequence:
        sequence = replace(sequence, rig=with_road(sequence.rig, given.road_z_m))
        lines = [*lenses_that_do_not_fit(sequence.rig)]
        if not given.exclude_cameras:
            names = [(sequence.topics or {})[name] for name in sequence.rig.names]
            lines += filter(None, [order_line(sequence.images(0), sequence.rig, names)])
        for line in lines:
            print(line, flush=True)
        yield sequence
