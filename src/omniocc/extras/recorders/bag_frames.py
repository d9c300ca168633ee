"""A ROS bag as the sequence of frames that `predict.py` predicts, with the samples that the recorder would take."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import torch

from omniocc.camera import Camera, Rig
from omniocc.data.formats.files import check_aspect
from omniocc.data.formats.poses import inverse
from omniocc.errors import UserError, in_line
from omniocc.extras.recorders.bag import (
    IMAGES,
    INFOS,
    POSES,
    TF,
    Bag,
    Topic,
    image_reader,
    image_topics,
    poses_of,
    rig_of_infos,
)
from omniocc.extras.recorders.bag_topics import (
    BASES,
    GUESS,
    WORLDS,
    Topics,
    first_of,
    guess_cameras,
    guess_names,
    info_beside,
    stated_topics,
)
from omniocc.extras.recorders.log import Log, Plan, Timing, check_timing, chosen_rig, plan_frames
from omniocc.extras.recorders.messages import FrameTree
from omniocc.extras.recorders.poses import TimedPoses, stated_pose
from omniocc.predict.input.images import check_excluded
from omniocc.predict.input.own import BagImages
from omniocc.predict.input.sequence import ALONE, EGO, ImageSequence, Mount


@contextmanager
def read_bag(given: BagImages) -> Iterator[ImageSequence]:
    """Give the frames of a bag while it is open, and print its topics, its poses and what is left out.

    Images are read when they are asked for, and none is kept.

    Raises:
        UserError, DataError: naming the option, topic or message that cannot be used.
    """
    stated = stated_topics(given.topics)
    try:
        timing = check_timing(Timing(stated.reference, stated.limit_s, stated.interval_s, stated.pose_gap_s))
        ego_from_base = (
            np.eye(4) if stated.ego_from_base is None else stated_pose("ego_from_base", stated.ego_from_base)
        )
    except ValueError as error:
        raise UserError(f"topics={given.topics}: {error}") from error
    with Bag(given.path) as bag:
        yield _sequence(bag, given, stated, timing, ego_from_base)


def _sequence(bag: Bag, given: BagImages, stated: Topics, timing: Timing, ego_from_base: np.ndarray) -> ImageSequence:
    tree = bag.tree()
    frames = tree.names
    base = stated.base_frame or first_of(BASES, frames)
    rig, cameras = _rig(bag, given, stated, tree, base, ego_from_base)
    kept = chosen_rig(rig, [name for name in rig.names if name not in given.excluded])
    guessed = "" if stated.cameras else " (guessed; topics=<file> names others)"
    told = ", ".join(f"{name}: {in_line(cameras[name])}" for name in kept.names)
    print(f"topics    {told}{guessed}", flush=True)  # before the times of all messages are read
    topics = image_topics(bag, {name: cameras[name] for name in kept.names})
    for name, topic in topics.items():
        check_order(topic, f"{given.path}, {in_line(cameras[name])}", timing.limit_s)
    source = _source_of_poses(bag, stated, tree, base)
    poses = None
    if source is not None:
        poses = poses_of(bag, tree, source.name, source.world, source.base)
        poses = poses._replace(poses=poses.poses @ inverse(ego_from_base))
    log = _log(bag, given, kept, [topics[name] for name in kept.names], poses)
    plan = plan_frames(log, timing)
    told = _no_poses(bag, stated) if source is None else source.told
    same = source is not None and stated.ego_from_base is None
    print(f"poses     {told}{', taken for the frame of the rig' * same}")
    for line in left_out(plan, timing.limit_s):
        print(line, flush=True)
    place = kept.names.index(timing.reference or kept.names[0])
    images = topics[kept.names[place]]
    stamps_ns = tuple(images.addresses[number].stamp_ns for number in plan.images[:, place])
    return ImageSequence(
        rig,
        tuple(map(str, stamps_ns)),
        _reader(log, plan, rig),
        None if poses is None else torch.from_numpy(plan.world_from_ego),
        stamps_ns,
        _mount(base if base in frames else None, stated, ego_from_base),
        {name: cameras[name] for name in kept.names},
    )


def _rig(
    bag: Bag, given: BagImages, stated: Topics, tree: FrameTree, base: str | None, ego_from_base: np.ndarray
) -> tuple[Rig, dict[str, str]]:
    """Return the rig and the topic of images of each camera that is not left out.

    Raises:
        UserError: when the bag has no calibration, or topics and cameras do not match.
    """
    images, infos = topics_of(bag, IMAGES), topics_of(bag, INFOS)
    if given.rig is not None:
        wanted = [name for name in given.rig.names if name not in given.excluded]
        if stated.cameras is None:
            return given.rig, guess_cameras(wanted, images, str(given.path))
        _check_cameras(given, stated.cameras, given.rig.names, wanted)
        return given.rig, dict(stated.cameras)
    cameras = dict(stated.cameras or guess_names(images, infos))
    beside = dict(stated.camera_info or {name: info_beside(topic) for name, topic in cameras.items()})
    lacking = [name for name in cameras if beside.get(name) not in infos]
    if not cameras or lacking:
        of = f" of camera '{lacking[0]}' ({in_line(cameras[lacking[0]])})" if lacking else ""
        have = in_line(", ".join(infos)) or "none"
        raise UserError(
            f"rig=... is needed: {given.path} has no CameraInfo{of}; topics of CameraInfo: {have}. Give a rig file, or "
            "name the topics in topics=<file> under camera_info"
        )
    if base is None:
        raise UserError(
            f"rig=... is needed: tf of {given.path} names no frame of the vehicle; give a rig file, or base_frame in "
            f"topics=<file>; frames: {in_line(', '.join(tree.names)) or 'none'}"
        )
    topics = image_topics(bag, cameras)
    rig = rig_of_infos(bag, tree, topics, {name: beside[name] for name in cameras}, cameras, base, ego_from_base)
    check_excluded(given.excluded, rig)
    return rig, cameras


def _check_cameras(given: BagImages, cameras: Mapping[str, str], names: Sequence[str], wanted: Sequence[str]) -> None:
    if unknown := [name for name in cameras if name not in names]:
        raise UserError(f"topics={given.topics}: the rig has no camera '{unknown[0]}'; it has {', '.join(names)}")
    if missing := [name for name in wanted if name not in cameras]:
        raise UserError(
            f"topics={given.topics}: camera '{missing[0]}' has no topic; add a line '{missing[0]}: /topic', or "
            f"exclude_cameras=[{missing[0]}]"
        )


class PoseSource(NamedTuple):
    """Where poses come from: a topic, or tf with its two frames; and that in words."""

    name: str
    world: str
    base: str
    told: str


def _source_of_poses(bag: Bag, stated: Topics, tree: FrameTree, base: str | None) -> PoseSource | None:
    """Return where the poses come from; None: there are none, or which they are is open."""
    worlds = [stated.world_frame] if stated.world_frame else WORLDS
    if stated.poses == GUESS:
        world = next((name for name in worlds if base and tree.moves(name, base)), None)
        if base and world:
            return PoseSource(TF, world, base, f"tf: {in_line(base)} in {in_line(world)}")
        found = topics_of(bag, POSES)
        return PoseSource(found[0], "", "", in_line(found[0])) if len(found) == 1 else None
    if stated.poses is None:
        return None
    base, world = base or BASES[0], first_of(worlds, tree.names) or worlds[0]
    told = f"tf: {base} in {world}" if stated.poses == TF else stated.poses
    return PoseSource(stated.poses, world, base, in_line(told))


def _no_poses(bag: Bag, stated: Topics) -> str:
    several = [] if stated.poses is None else topics_of(bag, POSES)
    choose = f"; poses in topics=<file> chooses one of {in_line(', '.join(several))}" if several else ""
    return f"none: frames are predicted without their past{choose}"


def _log(bag: Bag, given: BagImages, rig: Rig, images: Sequence[Topic], poses: TimedPoses | None) -> Log:
    if poses is None:  # the choice of images needs some at the times of the frames; nobody reads them
        times_s = np.unique(np.concatenate([topic.times_s for topic in images]))
        poses = TimedPoses(times_s, np.broadcast_to(np.eye(4), (len(times_s), 4, 4)))
    return Log(
        place=str(given.path),
        rig=rig,
        image_times_s=tuple(topic.times_s for topic in images),
        read_image=image_reader(bag, images, rig, given.depth),
        pose_times_s=poses.times_s,
        world_from_ego=poses.poses,
        scans=None,
        facts={},
    )


def _reader(log: Log, plan: Plan, rig: Rig) -> Callable[[int], list[np.ndarray]]:
    """Return the function that reads the images of a frame; those of cameras that are left out are black."""
    places = {name: place for place, name in enumerate(log.rig.names)}

    def read(frame: int) -> list[np.ndarray]:
        return [
            _checked(log, places[name], int(plan.images[frame, places[name]]), camera)
            if name in places
            else np.zeros((camera.height, camera.width, 3), np.uint8)
            for name, camera in zip(rig.names, rig.cameras, strict=True)
        ]

    return read


def _checked(log: Log, place: int, number: int, camera: Camera) -> np.ndarray:
    image, where = log.read_image(place, number)
    check_aspect((image.shape[1], image.shape[0]), camera, where)
    return image


def _mount(base: str | None, stated: Topics, ego_from_base: np.ndarray) -> Mount:
    if base is None:
        return ALONE
    return Mount(base) if stated.ego_from_base is None else Mount(EGO, base, inverse(ego_from_base))


def topics_of(bag: Bag, kinds: Sequence[str]) -> list[str]:
    """Return the topics of a bag with messages of some kinds."""
    return sorted({one.topic for one in bag.reader.connections if one.msgtype in kinds})


def check_order(topic: Topic, where: str, limit_s: float) -> None:
    """Check that the times in a topic's headers do not run backwards by more than `limit_s`, as messages come in.

    Messages that overtake each other are put in order; what was recorded after the clock was set back is not.

    Raises:
        UserError: beginning with `where`, naming the first such pair.
    """
    came = sorted(topic.addresses, key=lambda address: (address.received_ns, address.place))
    for before, after in itertools.pairwise(came):
        if after.stamp_ns < before.stamp_ns - limit_s * 1e9:
            raise UserError(
                f"{where}: times run backwards: {after.stamp_ns / 1e9:.6f} s comes after {before.stamp_ns / 1e9:.6f} s;"
                " was the clock set, or does the bag hold two recordings? Cut it there: each part is a bag of its own"
            )


def left_out(plan: Plan, limit_s: float) -> list[str]:
    """Return a line on the frames that are left out; none if there are none."""
    if not plan.missing:
        return []
    names = sorted({name for _, lacks in plan.missing for name in lacks})
    counts = ", ".join(f"{name} in {sum(name in lacks for _, lacks in plan.missing)}" for name in names)
    total = len(plan.missing) + len(plan.times_s)
    return [
        f"frames    {len(plan.missing)} of {total} are left out, without a sample within "
        f"{limit_s:g} s ({counts}); the first is at {plan.missing[0][0]:.6f} s"
    ]
