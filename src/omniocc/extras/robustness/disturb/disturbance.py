"""The kinds of disturbances, as functions of a rig or of a frame's images; the true labels stay as they are."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool

from omniocc.camera import Rig
from omniocc.camera.masks import mask_cameras
from omniocc.camera.miscalibrated import displaced_rig, turned, with_focal_factors
from omniocc.camera.ops.pixels import pixel_centers
from omniocc.data.augment.degrade import Image, noisy
from omniocc.extras.robustness.disturb.lens import behind_dirt, draw_dirt, draw_drops, through_drops

RigChange = Callable[[Rig, np.random.Generator], Rig]
ImageChange = Callable[[Sequence[Image], Rig, np.random.Generator], Sequence[Image]]


class Disturbance(NamedTuple):
    """What is wrong in all frames of a scene.

    Attributes:
        rig: from the true cameras to those that the system believes in; None: they are known.
        images: from the recorded images to those that the system gets, given the true cameras; None: as recorded.
        each_frame: whether `images` draws anew for every frame of a scene, instead of the same in all of them.
    """

    rig: RigChange | None = None
    images: ImageChange | None = None
    each_frame: bool = False


def turn_cameras(rig: Rig, rng: np.random.Generator, angle_deg: float) -> Rig:
    """Return the rig with every camera turned by an angle around a random axis of its own."""
    return turned(rig, _directions(rig, rng), angle_deg)


def move_cameras(rig: Rig, rng: np.random.Generator, distance_m: float) -> Rig:
    """Return the rig with every camera moved by a distance in a random direction of its own."""
    return displaced_rig(rig, _directions(rig, rng), distance_m)


def scale_focal_lengths(rig: Rig, rng: np.random.Generator, percent: float) -> Rig:
    """Return the rig with the focal length of every camera `percent` too long or too short, as likely as not."""
    signs = rng.choice((-1.0, 1.0), len(rig.cameras))
    return with_focal_factors(rig, (1 + signs * percent / 100).tolist())


def drop_random_cameras(rig: Rig, rng: np.random.Generator, count: int) -> Rig:
    """Return the rig without some cameras, the same ones for the same names; at least one camera stays."""
    chosen = rng.permutation(len(rig.names))[: min(count, len(rig.names) - 1)]
    return mask_cameras(rig, tuple(rig.names[k] for k in sorted(chosen)))


def every_image(
    images: Sequence[Image], rig: Rig, rng: np.random.Generator, change: Callable[[Image], Image]
) -> list[Image]:
    """Return all images changed in the same way."""
    del rig, rng
    return [change(image) for image in images]


def noise(images: Sequence[Image], rig: Rig, rng: np.random.Generator, percent: float) -> list[Image]:
    """Return all images with noise, see `noisy`."""
    del rig
    return [noisy(image, percent, rng) for image in images]


def drops_on_one_lens(images: Sequence[Image], rig: Rig, rng: np.random.Generator, percent: float) -> list[Image]:
    """Return the images with drops on a random lens, over `percent` of what it sees."""
    camera = int(rng.integers(len(images)))
    drops = draw_drops(lens_circle(rig, camera), percent, rng)
    return [through_drops(image, drops) if k == camera else image for k, image in enumerate(images)]


def dirt_on_one_lens(images: Sequence[Image], rig: Rig, rng: np.random.Generator, percent: float) -> list[Image]:
    """Return the images with dirt on a random lens, over `percent` of what it sees."""
    camera = int(rng.integers(len(images)))
    dirt = draw_dirt(lens_circle(rig, camera), percent, rng)
    return [behind_dirt(image, dirt) if k == camera else image for k, image in enumerate(images)]


def lens_circle(rig: Rig, camera: int) -> Bool[np.ndarray, "H W"]:
    """Return the pixels of a camera that its lens sees, the own car included."""
    model = rig.cameras[camera]
    return model.unproject(pixel_centers(model.width, model.height, torch.float64))[1].numpy()


def _directions(rig: Rig, rng: np.random.Generator) -> torch.Tensor:
    """Return a random direction for each camera, (N, 3), evenly spread over the sphere."""
    return torch.from_numpy(rng.standard_normal((len(rig.cameras), 3)))
