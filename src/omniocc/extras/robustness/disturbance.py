"""The kinds of disturbances of a frame's images, and scenes with one of these or of another rig.

The true labels stay as they are.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from omniocc import seeding
from omniocc.camera import Rig
from omniocc.camera.masks import lost_pixels
from omniocc.camera.ops.pixels import pixel_centers
from omniocc.data.augment.degrade import Image, add_noise, blur
from omniocc.data.source import SceneFrames

RigChange = Callable[[Rig, np.random.Generator], Rig]
ImageChange = Callable[[Sequence[Image], Rig, np.random.Generator], Sequence[Image]]
DROP = (0.02, 0.09)
"""Least and greatest radius of a drop, as a fraction of the image's height."""
REACH = 4.0
"""How many times as wide as the drop itself is what is seen through it, upside down."""
BLUR = 0.015
"""Standard deviation of the blur in a drop, as a fraction of the image's height."""
DIRT_RGB = (58, 50, 42)
GRAIN = 0.08
"""Size of a spot of dirt, as a fraction of the image's height."""


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


def every_image(
    images: Sequence[Image], rig: Rig, rng: np.random.Generator, change: Callable[[Image], Image]
) -> list[Image]:
    """Return all images changed in the same way."""
    del rig, rng
    return [change(image) for image in images]


def noise(images: Sequence[Image], rig: Rig, rng: np.random.Generator, percent: float) -> list[Image]:
    """Return all images with noise, see `add_noise`."""
    del rig
    return [add_noise(image, percent, rng) for image in images]


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


def disturb_scene(scene: SceneFrames, disturbance: Disturbance, name: str, seed: int) -> SceneFrames:
    """Return a scene with disturbed frames, which depend on the scene's name, the disturbance's name and the seed."""
    return cast(SceneFrames, DisturbedScene(scene, disturbance, name, seed))


class DisturbedScene:
    """A scene whose images and rigs are disturbed; all other attributes are those of the recorded scene.

    Pixels that the disturbed rig masks, and the recorded one does not, are black.
    """

    def __init__(self, scene: SceneFrames, disturbance: Disturbance, name: str, seed: int):
        self.scene, self.disturbance, self.disturbance_name, self.seed = scene, disturbance, name, seed

    def __getattr__(self, name: str) -> Any:
        if name == "scene":  # not there yet: the object is being unpickled
            raise AttributeError(name)
        return getattr(self.scene, name)

    def __len__(self) -> int:
        return len(self.scene)

    @property
    def undisturbed(self) -> SceneFrames:
        """Return the scene as it was recorded: its own cameras decide which cells were observed."""
        return self.scene

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame as the system believes them to be."""
        change = self.disturbance.rig
        if change is None:
            return tuple(self.scene.rigs)
        changed = {rig: change(rig, self._generator("rig")) for rig in dict.fromkeys(self.scene.rigs)}
        return tuple(changed[rig] for rig in self.scene.rigs)

    def images(self, frame: int) -> list[Image]:
        """Return the image of every camera, (H, W, 3) uint8 RGB each."""
        images, rig = self.scene.images(frame), self.scene.rigs[frame]
        if self.disturbance.images is not None:
            purpose = f"images {frame}" if self.disturbance.each_frame else "images"
            images = list(self.disturbance.images(images, rig, self._generator(purpose)))
        return images if self.rigs[frame] is rig else blackened(images, rig, self.rigs[frame])

    def _generator(self, purpose: str) -> np.random.Generator:
        return seeding.generator(self.scene.name, self.seed, f"{self.disturbance_name} {purpose}")


def blackened(images: Sequence[Image], rig: Rig, masked: Rig) -> list[Image]:
    """Return images that are black where `masked` allows no pixel and `rig` does."""
    lost = zip(images, lost_pixels(rig, masked), strict=True)
    return [image if not bool(torch.any(gone)) else image * ~gone.numpy()[..., None] for image, gone in lost]


class Drops(NamedTuple):
    """Drops of rain on a lens.

    Attributes:
        column: pixel of the image that each pixel shows.
        row: the same.
        cover: how much of each pixel a drop covers, 0..1.
        shade: factor on the light of each pixel: drops are darker at their upper rim.
    """

    column: Float32[np.ndarray, "H W"]
    row: Float32[np.ndarray, "H W"]
    cover: Float32[np.ndarray, "H W"]
    shade: Float32[np.ndarray, "H W"]


def draw_drops(seen: Bool[np.ndarray, "H W"], percent: float, rng: np.random.Generator) -> Drops:
    """Return drops of random places and sizes that cover at least `percent` of the pixels that the lens sees."""
    height, width = size = seen.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    drops = Drops(columns.copy(), rows.copy(), np.zeros(size, np.float32), np.ones(size, np.float32))
    while 100 * float((drops.cover[seen] > 0.5).mean()) < percent:
        radius = height * float(rng.uniform(*DROP))
        middle = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
        window = _around(middle, 1.2 * radius, size)  # cuts the soft rim above and below, of 1.3 radii
        across, down = columns[window] - middle[0], 0.85 * (rows[window] - middle[1])  # a little taller than wide
        away = np.hypot(across, down) / radius
        inside = np.clip((1.1 - away) / 0.2, 0, 1)
        newer = inside > drops.cover[window]
        drops.cover[window] = np.maximum(drops.cover[window], inside)
        for target, value in (
            (drops.column, middle[0] - REACH * across),
            (drops.row, middle[1] - REACH * down),
            (drops.shade, 1 - 0.35 * np.clip(away, 0, 1) ** 3 * (down < 0)),
        ):
            target[window] = np.where(newer, value, target[window])
    return drops._replace(cover=drops.cover * seen)


def through_drops(image: Image, drops: Drops) -> Image:
    """Return the image as it is seen through drops: inside of them turned upside down, smaller, and out of focus."""
    soft = blur(image, BLUR * image.shape[0])
    seen = np.asarray(cv2.remap(soft, drops.column, drops.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
    cover = drops.cover[..., None]
    mixed = image * (1 - cover) + seen * (cover * drops.shade[..., None])
    return np.rint(mixed).astype(np.uint8)


def draw_dirt(seen: Bool[np.ndarray, "H W"], percent: float, rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
    """Return how much of each pixel dirt hides, 0..1: more than half of it in `percent` of those that the lens sees."""
    size = seen.shape
    field = np.zeros(size, np.float32)
    for octave in range(3):
        sigma_px = GRAIN * size[0] / 2**octave
        noise = cv2.GaussianBlur(rng.standard_normal(size, dtype=np.float32), (0, 0), sigma_px)
        field += np.asarray(noise) * (sigma_px / 2**octave)  # of equal spread, then half as strong as the one before
    edge = float(np.quantile(field[seen], 1 - percent / 100))
    return (np.clip(0.5 + (field - edge) / (0.2 * float(field.std())), 0, 1) * seen).astype(np.float32)


def behind_dirt(image: Image, dirt: Float32[np.ndarray, "H W"]) -> Image:
    """Return the image behind dirt of one colour."""
    cover = dirt[..., None]
    return np.rint(image * (1 - cover) + np.array(DIRT_RGB, np.float32) * cover).astype(np.uint8)


def _around(middle: tuple[float, float], reach_px: float, size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of an image within a distance from a point (column, row)."""
    (column, row), (height, width) = middle, size
    first: Int64[np.ndarray, "2"] = np.floor(np.array([row, column]) - reach_px).astype(int)
    last = np.ceil(np.array([row, column]) + reach_px).astype(int) + 1
    return slice(max(first[0], 0), min(last[0], height)), slice(max(first[1], 0), min(last[1], width))
