"""Random changes of training batches, as the configuration chooses them."""

from collections.abc import Sequence

import torch

from omniocc.batch import Batch
from omniocc.classes import UNKNOWN
from omniocc.data.augment.flip_and_turn import Change, change_scenes, possible_turns
from omniocc.data.augment.image import erase, jitter
from omniocc.geometry import Grid


class Augment:
    """Erased boxes, other colours, mirrored and turned scenes, shorter histories; 0 switches each off.

    Erasing is the paper's ('random cropping on the input RGB images to enhance robustness against occlusion'). Labels
    of voxels stay, since the space behind an erased box can be inferred from other cameras, other frames and the
    surroundings. Labels of erased pixels become 255.

    Args:
        geometry: grid of the voxel labels.
        erase_probability: that an image loses a box.
        erase_fraction: smallest and largest box, as a fraction of the image.
        erase_aspect: smallest and largest width / height of a box.
        brightness: largest relative change, of every camera of every sample.
        contrast: largest relative change, of every camera of every sample.
        saturation: largest relative change, of every camera of every sample.
        hue_deg: largest turn of the colour circle, degrees.
        flip_probability: that a scene is mirrored left to right.
        yaw_probability: that a scene is turned about the vertical axis, by any step that takes cells to cells.
        drop_past_probability: that a past frame counts as not recorded, which saves its cost.

    Raises:
        ValueError: for a value that is no probability or fraction, or an empty range.
    """

    def __init__(
        self,
        geometry: Grid,
        erase_probability: float,
        erase_fraction: Sequence[float],
        erase_aspect: Sequence[float],
        brightness: float,
        contrast: float,
        saturation: float,
        hue_deg: float,
        flip_probability: float,
        yaw_probability: float,
        drop_past_probability: float,
    ):
        units = {
            "erase_probability": erase_probability,
            "flip_probability": flip_probability,
            "yaw_probability": yaw_probability,
            "drop_past_probability": drop_past_probability,
            "brightness": brightness,
            "contrast": contrast,
            "saturation": saturation,
        }
        for name, value in units.items():
            if not 0 <= value <= 1:
                raise ValueError(f"{name} is {value}; it must be from 0 (off) to 1")
        for name, pair, most in (("erase_fraction", erase_fraction, 1.0), ("erase_aspect", erase_aspect, float("inf"))):
            if len(pair) != 2 or not 0 < pair[0] <= pair[1] <= most:
                raise ValueError(f"{name} is {list(pair)}; it must be [smallest, largest], above 0 and at most {most}")
        self.geometry = geometry
        self.erasing = (erase_probability, tuple(erase_fraction), tuple(erase_aspect))
        self.colors = (brightness, contrast, saturation, hue_deg)
        self.flip_probability, self.yaw_probability = flip_probability, yaw_probability
        self.drop_past_probability = drop_past_probability

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return a changed batch, which depends on the state of `generator` (on the CPU), not on the batch's device."""
        if self.flip_probability or self.yaw_probability:
            batch = change_scenes(batch, self.geometry, self._changes(batch, generator))
        if self.drop_past_probability:
            batch = drop_past(batch, self.drop_past_probability, generator)
        images = batch.images
        if any(self.colors):
            mask = batch.image_mask()
            images = jitter(images, *self.colors, generator, None if bool(mask.all()) else mask)
        if self.erasing[0]:
            images, erased = erase(images, *self.erasing, generator, batch.image_sizes())
            if batch.pixel_labels is not None:  # of the newest frame
                batch = batch._replace(pixel_labels=batch.pixel_labels.masked_fill(erased[:, -1], UNKNOWN))
        return batch._replace(images=images)

    def _changes(self, batch: Batch, generator: torch.Generator) -> list[Change]:
        parts = possible_turns(batch, self.geometry)
        size = len(batch.frame_ids)
        flips = torch.rand(size, generator=generator) < self.flip_probability
        turns = torch.rand(size, generator=generator) < self.yaw_probability
        steps = torch.randint(0, parts, (size,), generator=generator) * turns
        draws = zip(flips.tolist(), steps.tolist(), strict=True)
        return [Change(flip, step, parts if step else 1) for flip, step in draws]


def drop_past(batch: Batch, probability: float, generator: torch.Generator) -> Batch:
    """Return windows in which each past frame counts as missing with this probability; the newest always stays."""
    kept = torch.rand(batch.images.shape[:2], generator=generator) >= probability
    kept[:, -1] = True
    kept = kept.to(batch.images.device)
    return batch._replace(exists=kept if batch.exists is None else batch.exists & kept)
