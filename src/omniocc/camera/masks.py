"""What of a rig is usable, and rigs of which less is: without some cameras, or with a narrower horizontal view."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from omniocc.camera.ops.pixels import pixel_centers
from omniocc.camera.rig import Rig

LEAST_FRACTION_WITH_RAY = 0.25
"""Smallest fraction of the pixels of an image for which the model of its lens has a ray, if it is the right model."""


@lru_cache(maxsize=8)
def mask_cameras(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return the rig with the named cameras masked entirely."""
    if not names:
        return rig
    masked = [
        torch.zeros(camera.height, camera.width, dtype=torch.bool) if name in names else mask
        for camera, name, mask in zip(rig.cameras, rig.names, rig.each_mask, strict=True)
    ]
    return replace(rig, masks=tuple(masked))


def drop_random_cameras(rig: Rig, rng: np.random.Generator, count: int) -> Rig:
    """Return the rig without some cameras, the same ones for the same names; at least one camera stays."""
    chosen = rng.permutation(len(rig.names))[: min(count, len(rig.names) - 1)]
    return mask_cameras(rig, tuple(rig.names[k] for k in sorted(chosen)))


def lost_pixels(rig: Rig, masked: Rig) -> Sequence[Bool[Tensor, "height width"]]:
    """Return the pixels of every camera that are usable in a rig and not in the same rig with other masks."""
    return [before & ~after for before, after in zip(usable_pixels(rig), usable_pixels(masked), strict=True)]


@lru_cache(maxsize=8)
def mask_view(rig: Rig, view_deg: float) -> Rig:
    """Return the rig with only the pixels that look at most half of `view_deg` to the left or right of straight ahead.

    What counts is the azimuth of a pixel's ray in the ego frame.
    """
    masks = []
    for camera, usable in enumerate(usable_pixels(rig)):
        x, y, _ = rig.rays(camera)[0].double().unbind(-1)
        masks.append(usable & (torch.atan2(y, x).abs() <= math.radians(view_deg / 2)))
    return replace(rig, masks=tuple(masks))


@lru_cache(maxsize=8)
def lenses_that_do_not_fit(rig: Rig) -> tuple[str, ...]:
    """Return a line for every camera whose lens model has no ray for most of its pixels; masks do not matter.

    Real lenses have one for two thirds of the image or more; wrong coefficients often end a few degrees off the axis.
    """
    lines = []
    for camera, name in zip(rig.cameras, rig.names, strict=True):
        _, has_ray = camera.unproject(pixel_centers(camera.width, camera.height, torch.float64))
        fraction = float(has_ray.float().mean())
        if fraction < LEAST_FRACTION_WITH_RAY:
            lines.append(
                f"camera '{name}': only {fraction:.0%} of its pixels have a ray; are the {type(camera).__name__} "
                "coefficients and the focal length those of its images?"
            )
    return tuple(lines)


def usable_pixels(rig: Rig) -> Sequence[Bool[Tensor, "height width"]]:
    """Return the masks of all cameras; everything is usable where a camera has none."""
    return [
        torch.ones(camera.height, camera.width, dtype=torch.bool) if mask is None else mask
        for camera, mask in zip(rig.cameras, rig.each_mask, strict=True)
    ]
