"""Other cameras for the same images: exposure, colours, blur, noise, vignette, glare, JPEG, a camera without an image.

What looks different is still as far away, so that a network for any camera learns to look at something else.
"""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from omniocc.batch import Batch
from omniocc.data.augment import degrade
from omniocc.data.augment.image import LUMINANCE, uniform

Images = Float[Tensor, "B N 3 H W"]


class Appearance:
    """Change images as other cameras would have taken them; 0 switches each change off.

    Args:
        exposure: largest change of a whole rig's exposure, and half of it that of each camera, in powers of two.
        gamma: largest change of the tone curve, in powers of two.
        white_balance: largest relative change of each colour of each camera.
        grey: probability that a rig has no colours.
        blur_px: greatest standard deviation of blur, px.
        noise: greatest standard deviation of noise, of 1.
        vignette: greatest fraction of light that is lost in the corners.
        glare: greatest light that is added around a random point and, half of it, everywhere.
        jpeg: probability that images are compressed, with a quality from 25 to 90.
        missing: probability that a rig of three cameras or more loses the image of one.

    Raises:
        ValueError: if a value is negative, or a probability above 1.
    """

    def __init__(
        self,
        exposure: float,
        gamma: float,
        white_balance: float,
        grey: float,
        blur_px: float,
        noise: float,
        vignette: float,
        glare: float,
        jpeg: float,
        missing: float,
    ):
        self.limits: Mapping[str, float] = {
            name: float(value) for name, value in locals().items() if name not in ("self", "__class__")
        }
        for name, value in self.limits.items():
            most = 1.0 if name in ("grey", "jpeg", "missing", "vignette") else float("inf")
            if not 0 <= value <= most:
                raise ValueError(f"{name} is {value}; it must be from 0 (off) to {most:g}")

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return a batch whose images are changed, and floats in [0, 1]; all frames of a window in the same way."""
        images, mask = batch.images.float() / 255, batch.image_mask()
        state, changed = generator.get_state(), []
        for frame in range(images.shape[1]):
            generator.set_state(state)
            changed.append(self.change(images[:, frame], mask[:, frame], generator))
        return batch._replace(images=torch.stack(changed, 1))

    def change(self, images: Images, mask: Bool[Tensor, "B N H W"], generator: torch.Generator) -> Images:
        """Return changed images in [0, 1]; padding (where `mask` is false) and images that are missing stay black.

        All draws are from `generator`, on the CPU.
        """
        rigs, cameras = images.shape[:2]
        limit, draw = self.limits, generator
        kept = (images.flatten(2).amax(2) > 0) & ~missing_ones(mask, limit["missing"], draw).to(images.device)
        changed = recolored(images, limit["white_balance"], limit["grey"], draw)
        changed = changed * shading((rigs, cameras), images.shape[-2:], limit["vignette"], draw).to(images)
        changed = changed + glare((rigs, cameras), images.shape[-2:], limit["glare"], draw).to(images)
        changed = developed(changed, limit["exposure"], limit["gamma"], draw)
        changed = blurred(changed, limit["blur_px"], draw)
        level = uniform((rigs, 1, 1, 1, 1), 0, limit["noise"], draw).to(images)
        changed = changed + level * torch.randn(images.shape, generator=draw).to(images)
        changed = compressed(changed.clamp(0, 1), limit["jpeg"], draw)
        return changed * (mask & kept[..., None, None])[:, :, None]


def missing_ones(mask: Bool[Tensor, "B N H W"], probability: float, generator: torch.Generator) -> Bool[Tensor, "B N"]:
    """Return at most one camera of each rig that is lost; rigs with fewer than three lose none."""
    real = mask.flatten(2).any(2).cpu()
    score = torch.rand(real.shape, generator=generator).where(real, -1)
    chosen = F.one_hot(score.argmax(1), real.shape[1]).bool()
    hit = torch.rand(len(real), generator=generator) < probability
    return chosen & hit[:, None] & (real.sum(1) > 2)[:, None]


def recolored(images: Images, white_balance: float, grey: float, generator: torch.Generator) -> Images:
    """Return images with other factors on the colours of every camera, some rigs without colours."""
    rigs, cameras = images.shape[:2]
    factors = uniform((rigs, cameras, 3, 1, 1), 1 - white_balance, 1 + white_balance, generator).to(images)
    without = (torch.rand(rigs, generator=generator) < grey).to(images.device).view(-1, 1, 1, 1, 1)
    luminance = (images * images.new_tensor(LUMINANCE).view(3, 1, 1)).sum(2, keepdim=True)
    return torch.where(without, luminance, images * factors)


def developed(images: Images, exposure: float, gamma: float, generator: torch.Generator) -> Images:
    """Return images of another exposure and tone curve, the same for a rig but for small differences of cameras."""
    rigs, cameras = images.shape[:2]
    stops = uniform((rigs, 1), -exposure, exposure, generator)
    stops = stops + uniform((rigs, cameras), -exposure / 2, exposure / 2, generator)
    power = uniform((rigs, 1), -gamma, gamma, generator).exp2().expand(-1, cameras)
    gain, power = (value.to(images)[..., None, None, None] for value in (stops.exp2(), power))
    return (images * gain).clamp(1e-4, 1) ** power


def _from_middle(size: tuple[int, int], middle: Float[Tensor, "*B 2"]) -> Float[Tensor, "*B H W"]:
    """Return the squared distance of the pixels from points in [-1, 1]."""
    rows, columns = (torch.linspace(-1, 1, length) for length in size)
    return (rows[:, None] - middle[..., 1, None, None]) ** 2 + (columns - middle[..., 0, None, None]) ** 2


def shading(leading: tuple[int, int], size: torch.Size, strength: float, generator: torch.Generator) -> Tensor:
    """Return factors (B, N, 1, H, W) of lenses that lose light towards the corners, the same for a rig."""
    loss = uniform((leading[0], 1, 1, 1, 1), 0, strength, generator)
    distance = _from_middle((size[0], size[1]), torch.zeros(2)) / 2
    return (1 - loss * distance).expand(*leading, 1, *size)


def glare(leading: tuple[int, int], size: torch.Size, strength: float, generator: torch.Generator) -> Tensor:
    """Return light (B, N, 1, H, W) that strays around a random point of every camera, and everywhere."""
    spots = uniform((*leading, 2), -1.3, 1.3, generator)
    level = uniform((*leading, 1, 1, 1), 0, strength, generator) * torch.rand((*leading, 1, 1, 1), generator=generator)
    halo = torch.exp(-3 * _from_middle((size[0], size[1]), spots))
    return level * (halo[:, :, None] + 0.5)


def blurred(images: Images, blur_px: float, generator: torch.Generator) -> Images:
    """Return images blurred by a Gaussian, as much in all cameras of a rig; half of the rigs are not."""
    sigmas = uniform((len(images),), -blur_px, blur_px, generator)
    return torch.stack([_smooth(rig, float(sigma)) for rig, sigma in zip(images, sigmas, strict=True)])


def _smooth(images: Float[Tensor, "N 3 H W"], sigma_px: float) -> Float[Tensor, "N 3 H W"]:
    if sigma_px < 0.2:
        return images
    offsets = torch.arange(-3, 4, device=images.device, dtype=images.dtype)
    weights = torch.exp(-(offsets**2) / (2 * sigma_px**2))
    weights = weights / weights.sum()
    maps = F.pad(images.flatten(0, 1)[:, None], (3, 3, 3, 3), mode="replicate")
    maps = F.conv2d(F.conv2d(maps, weights.view(1, 1, 1, 7)), weights.view(1, 1, 7, 1))
    return maps.view_as(images)


def compressed(images: Images, probability: float, generator: torch.Generator) -> Images:
    """Return images after JPEG compression; all cameras of a rig have the same quality."""
    hit = torch.rand(len(images), generator=generator) < probability
    quality = torch.randint(25, 91, (len(images),), generator=generator)
    parts = [_jpeg(rig, int(q)) if yes else rig for rig, yes, q in zip(images, hit, quality, strict=True)]
    return torch.stack(parts)


def _jpeg(images: Float[Tensor, "N 3 H W"], quality: int) -> Float[Tensor, "N 3 H W"]:
    pixels = (images.detach().cpu() * 255).round().byte().permute(0, 2, 3, 1).numpy()
    decoded = np.stack([degrade.compress_jpeg(one, quality) for one in pixels])
    return torch.from_numpy(decoded).permute(0, 3, 1, 2).to(images) / 255
