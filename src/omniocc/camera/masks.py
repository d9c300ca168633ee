"""What of a rig is usable, and rigs of which less is: without some cameras, or with a narrower horizontal view."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import torch
from jaxtyping import Bool
from torch import Tensor

from omniocc.camera.rig import Rig

FITTING_SHARE = 0.25
"""Share of the pixels with a ray below which a lens model is not that of its images."""


@lru_cache(maxsize=8)
def mask_cameras(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return the rig with the named cameras masked entirely."""
    if not names:
        return rig
    masks = rig.masks or (None,) * len(rig.cameras)
    masked = [
        torch.zeros(camera.height, camera.width, dtype=torch.bool) if name in names else mask
        for camera, name, mask in zip(rig.cameras, rig.names, masks, strict=True)
    ]
    return replace(rig, masks=tuple(masked))


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


def lenses_that_do_not_fit(rig: Rig) -> Iterator[str]:
    """Yield a line for every camera whose lens model has no ray for most of its pixels, masks aside.

    Real lenses have one for two thirds of the image or more; wrong coefficients often end a few degrees off the axis.
    """
    unmasked = replace(rig, masks=None)
    for index, (camera, name) in enumerate(zip(rig.cameras, rig.names, strict=True)):
        share = float(unmasked.rays(index)[1].float().mean())
        if share < FITTING_SHARE:
            yield (
                f"camera '{name}': only {share:.0%} of its pixels have a ray; are the {type(camera).__name__} "
                "coefficients and the focal length those of its images?"
            )


def usable_pixels(rig: Rig) -> Sequence[Bool[Tensor, "height width"]]:
    """Return the masks of all cameras; everything is usable where a camera has none."""
    masks = rig.masks or (None,) * len(rig.cameras)
    return [
        torch.ones(camera.height, camera.width, dtype=torch.bool) if mask is None else mask
        for camera, mask in zip(rig.cameras, masks, strict=True)
    ]
