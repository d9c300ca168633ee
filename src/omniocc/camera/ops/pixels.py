"""Pixel coordinates: integers are pixel centres, an image spans [-0.5, W-0.5] x [-0.5, H-0.5]."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def normalize_pixels(pixels: Float[Tensor, "*batch 2"], width: int, height: int) -> Float[Tensor, "*batch 2"]:
    """Return the coordinates for `grid_sample(align_corners=False)`, in which the image spans [-1, 1].

    They are independent of resolution: the result samples a feature map of the same image at any stride.
    """
    size = pixels.new_tensor([width, height])
    return (2 * pixels + 1) / size - 1


def pixel_centers(
    width: int, height: int, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> Float[Tensor, "height width 2"]:
    """Return (u, v) of every pixel."""
    u = torch.arange(width, dtype=dtype, device=device)
    v = torch.arange(height, dtype=dtype, device=device)
    return torch.stack(torch.meshgrid(u, v, indexing="xy"), dim=-1)


def in_image(pixels: Float[Tensor, "*batch 2"], width: int, height: int) -> Bool[Tensor, "*batch"]:
    """Return whether a pixel is in the image, its border included; false for NaN."""
    u, v = pixels.unbind(-1)
    return (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)


def farthest_px(width: int, height: int, center_px: tuple[float, float], affine: tuple[float, ...]) -> float:
    """Return a distance from the centre, px, beyond every pixel before an affine map with diagonal (1, c) or (c, 1)."""
    c, d, e = affine
    reach = math.hypot(width + abs(center_px[0]), height + abs(center_px[1]))
    return reach * (1 + abs(c) + abs(d) + abs(e)) / (c - d * e)


def usable(
    mask: Bool[Tensor, "height width"] | None, pixels: Float[Tensor, "*batch 2"], valid: Bool[Tensor, "*batch"]
) -> Bool[Tensor, "*batch"]:
    """Return which valid pixels are usable: true in a mask at the nearest pixel; all of them where there is no mask."""
    if mask is None:
        return valid
    nearest = torch.where(valid[..., None], pixels, 0).round().long()
    u = nearest[..., 0].clamp(0, mask.shape[1] - 1)
    v = nearest[..., 1].clamp(0, mask.shape[0] - 1)
    return valid & mask.to(pixels.device)[v, u]
