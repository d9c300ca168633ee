"""Training batches with what breaks a model: lost cameras, wrong calibrations, images of other sizes, worse images."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from torch.nn import functional as F

from omniocc import seeding
from omniocc.batch import Batch
from omniocc.bounds import Count, Degrees, Fraction, Metres
from omniocc.camera import Rig
from omniocc.camera.masks import drop_random_cameras, lost_pixels
from omniocc.camera.miscalibrated import move_cameras, scale_focal_lengths, turn_cameras
from omniocc.classes import UNKNOWN
from omniocc.data.augment.appearance import Appearance
from omniocc.errors import UserError

Windows = tuple[tuple[Rig, ...], ...]
"""The rig of every frame of every sample."""


class Disturbances:
    """Disturb some training batches: cameras, rigs or scale, and images besides; labels of voxels and panoramas stay.

    A disturbed batch has no stored ranges, candidates and evidence, so that the model computes them from the disturbed
    images and rigs, as it does in a test. What is wrong is drawn for each sample, and the scale for the batch: images
    of several sizes would be padded.

    Args:
        camera_probability: that samples lose cameras: their images are black.
        most_cameras: lost by a sample, at least one of whose cameras stays.
        told_fraction: of the samples that lose cameras; their rigs mask these cameras. The others are not told.
        rig_probability: that samples have wrong rigs; their images are those of the true ones.
        turn_deg: largest error of every camera's rotation, about a random axis.
        move_m: largest error of every camera's position, in a random direction.
        focal_percent: largest error of every focal length, too long or too short.
        versions: number of wrong rigs of each true one. What is computed once for a rig, such as the samplers of the
            depth network, is kept for so many more rigs.
        scale_probability: that images and rigs have another scale.
        scales: the factors of their width and height.
        image_probability: that images look as other cameras take them, whatever else is wrong.
        appearance: how these images look.

    Raises:
        ValueError: if the probabilities of cameras, rigs and scale exceed 1 together, or a scale is not above 0.
    """

    def __init__(
        self,
        camera_probability: Fraction,
        most_cameras: Count,
        told_fraction: Fraction,
        rig_probability: Fraction,
        turn_deg: Degrees,
        move_m: Metres,
        focal_percent: float,
        versions: Count,
        scale_probability: Fraction,
        scales: Sequence[float],
        image_probability: Fraction,
        appearance: Appearance,
    ):
        total = camera_probability + rig_probability + scale_probability
        if total > 1 + 1e-9:
            raise ValueError(f"the probabilities of lost cameras, rigs and scales are {total:g} together, above 1")
        if not 0 <= focal_percent < 100:
            raise ValueError(f"focal_percent is {focal_percent}; it must be from 0 on and below 100")
        if not scales or min(scales) <= 0:
            raise ValueError(f"scales are {list(scales)}; give one or more, above 0")
        self.ways = (
            (camera_probability, self.lose_cameras),
            (rig_probability, self.believe_wrong_rigs),
            (scale_probability, self.scale_images),
        )
        self.image_probability = image_probability
        self.most_cameras, self.told_fraction = most_cameras, told_fraction
        self.errors, self.versions = (turn_deg, move_m, focal_percent), versions
        self.scales, self.appearance = tuple(scales), appearance

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return a batch that may be disturbed; all draws are from `generator`, on the CPU.

        Raises:
            UserError: when the focal length of a camera model cannot be wrong.
        """
        draw, image_draw = torch.rand(2, generator=generator).tolist()
        chosen = [self.change_images] if image_draw < self.image_probability else []
        for probability, disturb in self.ways:
            if 0 <= draw < probability:
                chosen.append(disturb)
            draw -= probability
        for disturb in chosen:
            batch = disturb(batch, generator)
        return batch._replace(depth_range_m=None, candidates=None, evidence=None) if chosen else batch

    def lose_cameras(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return samples without some cameras, which only some rigs tell; their pixels have no labels."""
        size = (len(batch.rigs),)
        told = (torch.rand(size, generator=generator) < self.told_fraction).tolist()
        counts = torch.randint(1, self.most_cameras + 1, size, generator=generator).tolist()
        seeds = torch.randint(2**31, size, generator=generator).tolist()
        masked = tuple(
            tuple(drop_random_cameras(rig, np.random.default_rng(seed), count) for rig in frames)
            for frames, count, seed in zip(batch.rigs, counts, seeds, strict=True)
        )
        gone = pixels_of_lost(batch, masked, told).to(batch.images.device)
        labels, range_m = batch.pixel_labels, batch.camera_range_m
        return batch._replace(
            images=batch.images.masked_fill(gone.unsqueeze(3), 0),
            rigs=tuple(
                after if knows else before for before, after, knows in zip(batch.rigs, masked, told, strict=True)
            ),
            pixel_labels=None if labels is None else labels.masked_fill(gone[:, -1], UNKNOWN),
            camera_range_m=None if range_m is None else range_m.masked_fill(gone[:, -1], torch.nan),
        )

    def believe_wrong_rigs(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return samples whose rigs are wrong, each one of a few versions; all frames have the same errors."""
        numbers = torch.randint(self.versions, (len(batch.rigs),), generator=generator).tolist()
        return batch._replace(
            rigs=tuple(
                tuple(wrong_rig(rig, frames[-1].fingerprint, number, *self.errors) for rig in frames)
                for frames, number in zip(batch.rigs, numbers, strict=True)
            )
        )

    def scale_images(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return images of another size and the rigs that belong to them."""
        scale = self.scales[int(torch.randint(len(self.scales), (), generator=generator))]
        return resized(batch, tuple(tuple(scaled_rig(rig, scale) for rig in frames) for frames in batch.rigs))

    def change_images(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return images as other cameras take them."""
        return batch._replace(images=(255 * self.appearance(batch, generator).images).round().to(torch.uint8))


def pixels_of_lost(batch: Batch, masked: Windows, told: Sequence[bool]) -> Bool[Tensor, "B T N H W"]:
    """Return the pixels that `masked` rigs lose; where a sample is not told, all of a camera that loses any."""
    *leading, _, height, width = batch.images.shape
    found = torch.zeros(*leading, height, width, dtype=torch.bool)
    for sample, frame in product(*map(range, leading[:2])):
        lost = lost_pixels(batch.rigs[sample][frame], masked[sample][frame])
        for camera, gone in enumerate(lost):
            rows, columns = gone.shape
            found[sample, frame, camera, :rows, :columns] = gone if told[sample] else gone.any()
    return found


@lru_cache(maxsize=256)
def wrong_rig(rig: Rig, theme: str, number: int, turn_deg: float, move_m: float, focal_percent: float) -> Rig:
    """Return one wrong version of a rig.

    The errors depend on theme, number and the largest errors: every camera has a direction and a sign of its own, and
    the sizes are uniformly drawn for the rig.

    Raises:
        UserError: naming a camera model whose images have no centre, if focal lengths are to be wrong.
    """
    rng = seeding.generator(theme, number, "wrong rig")
    turn, move, focal = rng.uniform(size=3) * (turn_deg, move_m, focal_percent)
    rig = move_cameras(turn_cameras(rig, rng, turn), rng, move)
    try:
        return scale_focal_lengths(rig, rng, focal) if focal_percent else rig
    except ValueError as error:
        raise UserError(f"disturbances.focal_percent={focal_percent:g}: {error}; give 0") from error


@lru_cache(maxsize=256)
def scaled_rig(rig: Rig, scale: float) -> Rig:
    """Return `rig.scaled(scale)`, once, since a rig computes its fingerprint once."""
    return rig.scaled(scale)


def resized(batch: Batch, rigs: Windows) -> Batch:
    """Return images with the sizes of other rigs; labels and ranges of pixels are those of the nearest pixel."""
    frames = [pair for before, after in zip(batch.rigs, rigs, strict=True) for pair in zip(before, after, strict=True)]
    newest = [(before[-1], after[-1]) for before, after in zip(batch.rigs, rigs, strict=True)]
    labels, range_m = batch.pixel_labels, batch.camera_range_m
    return batch._replace(
        images=resize(batch.images.flatten(0, 1), frames, 0).unflatten(0, batch.images.shape[:2]),
        rigs=rigs,
        pixel_labels=None if labels is None else resize(labels.unsqueeze(2), newest, UNKNOWN, "nearest-exact")[:, :, 0],
        camera_range_m=None
        if range_m is None
        else resize(range_m.unsqueeze(2), newest, torch.nan, "nearest-exact")[:, :, 0],
    )


def resize(values: Tensor, rigs: Sequence[tuple[Rig, Rig]], fill: float, mode: str = "bilinear") -> Tensor:
    """Return images (B, N, C, H, W) of rigs with the sizes of other ones, padded with `fill`.

    Args:
        values: padded images of the first rig of each pair, any type.
        rigs: for each sample the rig that it has, and the one that it is to have.
        fill: value of the padding.
        mode: of `torch.nn.functional.interpolate`.
    """
    cameras = [camera for _, rig in rigs for camera in rig.cameras]
    size = max(camera.height for camera in cameras), max(camera.width for camera in cameras)
    found = values.new_full((*values.shape[:3], *size), fill)
    for sample, (before, after) in enumerate(rigs):
        for camera, (old, new) in enumerate(zip(before.cameras, after.cameras, strict=True)):
            image = values[sample, camera, :, : old.height, : old.width].float()[None]
            image = F.interpolate(image, (new.height, new.width), mode=mode, antialias=mode == "bilinear")[0]
            found[sample, camera, :, : new.height, : new.width] = image if values.is_floating_point() else image.round()
    return found
