"""Random changes of pixels: erased boxes and colours."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

LUMINANCE = (0.299, 0.587, 0.114)
YIQ_FROM_RGB = (LUMINANCE, (0.5959, -0.2746, -0.3213), (0.2115, -0.5227, 0.3112))


def uniform(size: Sequence[int], low: float, high: float, generator: torch.Generator) -> Tensor:
    """Return uniform draws on the CPU, so that they do not depend on the device of the images."""
    return torch.rand(tuple(size), generator=generator) * (high - low) + low


def erase(
    images: Tensor,
    probability: float,
    fraction: Sequence[float],
    aspect: Sequence[float],
    generator: torch.Generator,
    sizes: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, Tensor]:
    """Cover one box in some images with one colour (Random Erasing, Zhong et al. 2020).

    The paper that this project implements calls it random cropping.

    Args:
        images: (..., 3, H, W) uint8.
        probability: that an image loses a box.
        fraction: smallest and largest area, as a fraction of the image's; uniformly drawn.
        aspect: smallest and largest width / height; its logarithm is uniformly drawn.
        generator: of all draws, on the CPU.
        sizes: width and height of every image, (...) int64 each, px, on the CPU, where images are padded at the end of
            rows and columns; None: all of W and H.

    Returns:
        The images and the erased pixels, (..., H, W) bool.
    """
    *leading, _, height, width = images.shape
    hit = torch.rand(tuple(leading), generator=generator) < probability
    image_width, image_height = (torch.full(leading, width), torch.full(leading, height)) if sizes is None else sizes
    area_px = uniform(leading, fraction[0], fraction[1], generator) * (image_height * image_width)
    ratio = uniform(leading, math.log(aspect[0]), math.log(aspect[1]), generator).exp()
    wide = (area_px * ratio).sqrt().round().clamp(min=1).minimum(image_width)
    high = (area_px / ratio).sqrt().round().clamp(min=1).minimum(image_height)
    left = (torch.rand(tuple(leading), generator=generator) * (image_width - wide + 1)).floor()
    top = (torch.rand(tuple(leading), generator=generator) * (image_height - high + 1)).floor()
    color = torch.randint(0, 256, (*leading, 3, 1, 1), generator=generator, dtype=torch.uint8)
    columns, rows = torch.arange(width), torch.arange(height)
    inside_columns = (columns >= left[..., None]) & (columns < (left + wide)[..., None]) & hit[..., None]
    inside_rows = (rows >= top[..., None]) & (rows < (top + high)[..., None])
    box = inside_rows[..., None, :, None].to(images.device) & inside_columns[..., None, None, :].to(images.device)
    return torch.where(box, color.to(images.device), images), box.squeeze(-3)


def jitter(
    images: Tensor,
    brightness: float,
    contrast: float,
    saturation: float,
    hue_deg: float,
    generator: torch.Generator,
    mask: Tensor | None = None,
) -> Tensor:
    """Change the colours of every camera of every sample; all frames of a window share the change, like an exposure.

    Args:
        images: (B, T, N, 3, H, W) uint8.
        brightness: factors are drawn from 1 - brightness to 1 + brightness.
        contrast: factors are drawn from 1 - contrast to 1 + contrast; they act around the image's mean luminance.
        saturation: factors are drawn from 1 - saturation to 1 + saturation; they act around each pixel's luminance.
        hue_deg: largest turn of the colour circle, either way, degrees.
        generator: of all draws, on the CPU.
        mask: (B, T, N, H, W) bool, pixels that are no padding; None: all are. Padding stays 0.
    """
    leading = (images.shape[0], 1, images.shape[2])
    factors = [uniform(leading, 1 - spread, 1 + spread, generator) for spread in (brightness, contrast, saturation)]
    bright, contrasted, vivid = (factor[..., None, None].to(images.device) for factor in factors)
    angle_rad = uniform(leading, -math.radians(hue_deg), math.radians(hue_deg), generator).to(images.device)
    weights = torch.tensor(LUMINANCE, device=images.device)
    grey = weights.expand(3, 3)  # makes every colour its luminance
    color = bright * (contrasted * (hue_matrix(angle_rad) * vivid + grey * (1 - vivid)))
    pixels = images.float()
    if mask is None:
        mean = pixels.mean((-2, -1))
    else:
        mean = pixels.sum((-2, -1)) / mask.sum((-2, -1)).clamp(min=1).unsqueeze(-1)
    shift = bright * (1 - contrasted) * (mean @ weights)[..., None, None]
    changed = ((color @ pixels.flatten(-2)) + shift).round().clamp(0, 255).to(torch.uint8).view_as(images)
    return changed if mask is None else changed * mask.unsqueeze(-3)


def hue_matrix(angle_rad: Tensor) -> Tensor:
    """Return matrices (..., 3, 3) that turn RGB around the grey axis and keep the luminance."""
    yiq = torch.tensor(YIQ_FROM_RGB, device=angle_rad.device)
    turn = torch.zeros(*angle_rad.shape, 3, 3, device=angle_rad.device)
    turn[..., 0, 0] = 1
    turn[..., 1, 1] = turn[..., 2, 2] = angle_rad.cos()
    turn[..., 1, 2], turn[..., 2, 1] = -angle_rad.sin(), angle_rad.sin()
    return torch.linalg.inv(yiq) @ turn @ yiq
