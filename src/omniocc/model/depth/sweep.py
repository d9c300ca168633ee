"""A sphere sweep without weights for any calibrated rig whose fields of view overlap."""

import itertools
from collections.abc import Iterator
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from omniocc.bounds import Fraction
from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.depth_map import SKY_INDEX, DepthMap, from_index
from omniocc.model.ops.depth.panorama_depth import PanoramaDepth
from omniocc.model.ops.depth.projection import Present, Projection, present_cameras, samplers, table
from omniocc.model.ops.depth.spheres import SphereRange
from omniocc.model.ops.padded import frame_size

NOISE = 0.01
"""Standard deviation of grey values (of 1) up to which a window has no texture."""
UNSEEN = -1.0


class Sweep(PanoramaDepth):
    """Compare all pairs of cameras by zero-mean normalised cross-correlation of windows on every sphere.

    The sphere with the best mean over the pairs wins, and a parabola through it and its neighbours gives the fraction.
    Images are first brought to about the resolution of the panorama.

    Other arguments as in `PanoramaDepth`.

    Args:
        window_px: side of the windows in the panorama, odd.
        min_confidence: ranges of lower confidence are not valid, in [0, 1].

    Raises:
        ValueError: if the window is even or does not fit into the panorama.
    """

    COMPARES_CAMERAS: ClassVar[bool] = True

    def __init__(self, panorama: Equirectangular, spheres: SphereRange, window_px: int, min_confidence: Fraction):
        super().__init__(panorama, spheres)
        size = panorama.width, panorama.height
        if window_px < 3 or window_px % 2 == 0 or window_px > min(size):
            raise ValueError(f"window_px is {window_px}; it must be odd, at least 3, and fit into {list(size)}")
        self.window_px, self.min_confidence = window_px, min_confidence

    @torch.no_grad()
    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        score = torch.cat(list(self._scores(images, rig)), 1)
        index, confidence = peak(score)
        compared = score.amax(1) > UNSEEN
        valid = compared & (index >= SKY_INDEX) & (confidence >= self.min_confidence)
        return from_index(index, valid, confidence * compared, self.rig_spheres(rig))

    def _scores(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> Iterator[Float[Tensor, "B D h w"]]:
        """Yield the mean correlation block by block of spheres."""
        present = Present.of(present_cameras(images))
        grey = F.interpolate(images.float().mean(2), self._working_size(rig), mode="area")
        size = grey.shape[-1], grey.shape[-2]
        sweeps = [
            Projection(self.panorama, self.rig_spheres(rig), size, (k,), self.spheres.planes)
            for k in range(len(rig.cameras))
        ]
        cameras = [samplers(rig, sweep, images.device) for sweep in sweeps]
        rows = table(grey[:, :, None], present)
        shape = (-1, self.panorama.height, self.panorama.width)
        for block in zip(*cameras, strict=True):
            swept = torch.stack([sampler(rows).T.unflatten(1, shape) for sampler in block], 2)
            seen = torch.stack([sampler.seen.unflatten(0, shape) for sampler in block], 1)
            compared = (seen & present.mask[:, None, :, None, None]).flatten(0, 1)
            score = correlation(swept.flatten(0, 1), compared, self.window_px)
            yield score.unflatten(0, swept.shape[:2])

    def _working_size(self, rig: Rig) -> tuple[int, int]:
        """Return the height and width of images whose pixels are at least as wide as the panorama's."""
        camera, (width, height) = rig.cameras[0], frame_size(rig)
        middle = torch.tensor([[camera.width / 2, camera.height / 2], [camera.width / 2 + 1, camera.height / 2]])
        rays, _ = camera.unproject(middle.double())
        angle_rad = float((rays[0] - rays[1]).norm())
        factor = max(1.0, 2 * torch.pi / self.panorama.width / angle_rad)
        return max(2, round(height / factor)), max(2, round(width / factor))


def box(maps: Float[Tensor, "M N h w"], side_px: int) -> Float[Tensor, "M N h w"]:
    """Return the mean over square windows; wraps around in azimuth, repeats the first and last row."""
    half = side_px // 2
    maps = F.pad(maps, (half, half, 0, 0), mode="circular")
    return F.avg_pool2d(F.pad(maps, (0, 0, half, half), mode="replicate"), side_px, stride=1)


def correlation(swept: Float[Tensor, "M N h w"], seen: Bool[Tensor, "M N h w"], side_px: int) -> Float[Tensor, "M h w"]:
    """Return the mean zero-mean normalised cross-correlation over pairs of cameras that see a whole window, or -1."""
    mean = box(swept, side_px)
    deviation = (box(swept.square(), side_px) - mean.square()).clamp(min=0).add(NOISE**2).sqrt()
    whole = box(seen.to(swept), side_px) > 1 - 0.5 / side_px**2
    total, pairs = torch.zeros_like(mean[:, 0]), torch.zeros_like(mean[:, 0])
    for i, j in itertools.combinations(range(swept.shape[1]), 2):
        both = whole[:, i] & whole[:, j]
        if bool(both.any()):
            product = box((swept[:, i] * swept[:, j])[:, None], side_px)[:, 0]
            common = (product - mean[:, i] * mean[:, j]) / (deviation[:, i] * deviation[:, j])
            total, pairs = total + common * both, pairs + both
    return torch.where(pairs > 0, total / pairs.clamp(min=1), UNSEEN)


def peak(score: Float[Tensor, "B D h w"]) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return the index of the best sphere, with a fraction from a parabola, and its lead over others, in [0, 1].

    The confidence is the best score less the best one that is at least three spheres away, which counts as 0 if it is
    negative.
    """
    best, place = score.max(1, keepdim=True)
    last = score.shape[1] - 1
    left, right = (score.gather(1, (place + side).clamp(0, last)) for side in (-1, 1))
    bend = left - 2 * best + right
    inner = (place > 0) & (place < last) & (bend < 0)
    shift = torch.where(inner, 0.5 * (left - right) / torch.where(inner, bend, 1), 0)
    spheres = torch.arange(last + 1, device=score.device).view(1, -1, 1, 1)
    rival = torch.where((spheres - place).abs() > 2, score, 0).amax(1, keepdim=True)
    return (place + shift)[:, 0], (best - rival).clamp(0, 1)[:, 0]
