"""Omnidirectional depth by one combined sweep and 2D regularisation (paper, section IV-B; RtHexa-OmniMVS)."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar, Literal

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Count, CountOrNone, Fraction, Size, SizeOrNone
from omniocc.camera import Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre
from omniocc.model.ops.depth.layers import FeatureNet, PanoramaConv, UNet2d
from omniocc.model.ops.depth.projection import (
    Present,
    Projection,
    Sampler,
    alternate_cameras,
    divided_samplers,
    samplers,
    similarity,
    table,
)
from omniocc.model.ops.depth.sphere_net import SphereLoss, SphereNet
from omniocc.model.ops.depth.spheres import SphereRange, Spheres
from omniocc.model.ops.efficientnet import FrozenLite0
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padded import Rigs, joined
from omniocc.model.ops.padding import upsample_view
from omniocc.model.ops.rig_cache import once_per_rig

HINTS = 5
"""Number of maps that `rig_hints` returns."""
PROBES_M = (3.0, 12.0)
"""Ranges at which the parallax is computed."""
MANY_CAMERAS = 4
FAR_BELOW_M = 0.05
"""Lower limit of the range of the road in `rig_hints`, m."""
CONTEXT_SPHERES = (0.06, 0.25)
"""Spheres on which the features of both views are passed on, as fractions of the index of the nearest sphere."""

UNTOLD = 0.5
"""Fraction of training batches in which the network is not told the height of the road."""

FIRST_TRUST = 4.0
"""Score that full similarity adds to a sphere before training."""


@once_per_rig
def rig_hints(rig: Rig, panorama: Equirectangular, spheres: Spheres) -> Float32[Tensor, "5 h w"]:
    """Return maps of what a network must not learn by heart, since it differs between rigs; each about 0 to 1.

    Pixels of parallax between neighbouring spheres, compressed, at two ranges; how many cameras see a far point; the
    sphere on which the road lies if it is flat (0 above the horizon); whether the height of the road is known.
    """
    rays = panorama.rays().double()
    parallax = []
    for range_m in PROBES_M:
        metres_per_sphere = range_m**2 * spheres.step_per_m
        parallax.append((pixels_per_metre(rig, rays * range_m) * metres_per_sphere).log1p())
    cameras = rig.project(rays * 1e3)[1].sum(0).double() / MANY_CAMERAS
    road, known = torch.zeros_like(cameras), torch.full_like(cameras, float(rig.road_z_m is not None))
    if rig.road_z_m is not None:
        range_m = rig.road_z_m / rays[..., 2].clamp(max=-1e-6)
        road = torch.where(rays[..., 2] < 0, spheres.index(range_m.clamp(min=FAR_BELOW_M)) / spheres.count, 0)
    return torch.stack([*parallax, cameras.clamp(max=1), road.clamp(max=1), known]).float()


@lru_cache(maxsize=16)
def row_hint(height: int, device: torch.device) -> Float32[Tensor, "h 1"]:
    """Return 1 at the upper edge of a panorama to -1 at the lower one."""
    with torch.inference_mode(False):  # training may use it as well
        return (1 - 2 * (torch.arange(height, device=device) + 0.5) / height)[:, None]


class OmniMVS(SphereNet):
    """Find where two panoramas of features agree on every sphere: one from every other camera, one from the rest.

    The similarity of the two panoramas on all spheres, by groups of channels, and the mean and difference of their
    features (so that the two sets may be swapped) go through a 2D network that wraps around. Rotating a rig
    of even symmetry by one camera rotates the answer.

    Other arguments as in `SphereNet`.

    Args:
        feature_channels: per level of the feature network, finest (half the image size) first; multiples of 8.
        feature_stride: image pixels per feature along each side, 1 or 2.
        match_channels: features that are compared.
        groups: similarities per sphere, a divisor of `match_channels`.
        context_channels: features that are passed on without comparison.
        sweep_stride: panorama pixels per swept point along each side, 1 or 2.
        channels: per level of the 2D network, finest (half the panorama) first; multiples of 8.
        fine_channels: of the layers at full size, which get the similarities and the mean features again.
        blocks: residual blocks on each level, down and up again.
        pairs: how cameras are divided into the two sets. `alternate`: every other camera of the ring, in all
            directions. `nearest`: every other one of those that see a point, by its angle from their axes, so that two
            cameras are compared wherever two see, in any rig.
        hints: whether the network is told what the rig alone says of a direction: parallax, number of cameras, road.
        pretrained: whether frozen features of EfficientNet-Lite0 are added to those that are compared and passed on.
        weights: of these frozen features: those of ImageNet, from the extra `pretrained`, or None for random ones.

    Raises:
        ValueError: if `pairs` is neither of the two, or groups, stride or panorama do not fit together.
        UserError: if the weights of the frozen features are not installed.
    """

    PRETRAINED: ClassVar = ("weights",)
    ADDS_NOTHING_AT_FIRST: ClassVar = ("features.pretrained.", "features.added.")
    """Beginnings of the names of weights that a network which was trained without `pretrained` may lack."""

    def __init__(
        self,
        panorama: Equirectangular,
        spheres: SphereRange,
        loss: SphereLoss,
        feature_channels: list[Size],
        feature_stride: int,
        match_channels: Size,
        groups: Count,
        context_channels: SizeOrNone,
        sweep_stride: int,
        channels: list[Size],
        fine_channels: Size,
        blocks: CountOrNone,
        window: CountOrNone,
        min_confidence: Fraction,
        mirror: bool,
        pairs: str = "alternate",
        hints: bool = False,
        pretrained: bool = False,
        weights: Literal["imagenet"] | None = None,
    ):
        super().__init__(panorama, spheres, loss, window, min_confidence, mirror)
        width, height = panorama.width, panorama.height
        if match_channels % groups:
            raise ValueError(f"{match_channels} match_channels cannot be split into {groups} groups; give a divisor")
        if sweep_stride not in (1, 2):
            raise ValueError(f"sweep_stride is {sweep_stride}; it must be 1 or 2")
        if width % 2 ** len(channels) or height % 2:
            raise ValueError(
                f"the panorama is {width}x{height} px; {len(channels)} levels need an even height "
                f"and a width in multiples of {2 ** len(channels)}"
            )
        if pairs not in ("alternate", "nearest"):
            raise ValueError(f"pairs is {pairs}; it must be alternate or nearest")
        self.match_channels, self.groups, self.sweep_stride = match_channels, groups, sweep_stride
        self.pairs, self.hints = pairs, hints
        self.swept = panorama.resized(width // sweep_stride, height // sweep_stride)
        frozen = FrozenLite0(weights) if pretrained else None
        self.features = FeatureNet(
            feature_channels, match_channels + context_channels, stride=feature_stride, pretrained=frozen
        )
        compared = groups * spheres.count
        inputs = compared + 2 * len(CONTEXT_SPHERES) * context_channels + 3 + HINTS * hints
        self.stem = nn.Conv2d(inputs, channels[0], 2 // sweep_stride, stride=2 // sweep_stride)
        self.net = UNet2d(channels, blocks, wrap=True)
        self.up = nn.Sequential(nn.Conv2d(channels[0], 4 * fine_channels, 1), nn.PixelShuffle(2))
        self.skipped = compared + len(CONTEXT_SPHERES) * context_channels
        self.fine = nn.Sequential(
            PanoramaConv(self.skipped + fine_channels, fine_channels, 3, wrap=True, bias=False),
            group_norm(fine_channels),
            nn.ReLU(),
            PanoramaConv(fine_channels, spheres.count + 1, 3, wrap=True),
        )
        self.trust = nn.Parameter(torch.full((), FIRST_TRUST))

    def scores(self, swept: Float[Tensor, "B C _ _"]) -> Float[Tensor, "B E h w"]:
        """Return scores of spheres and sky: those of the 2D network, and the similarity on each sphere."""
        coarse = self.up(self.net(self.stem(swept)))
        skip = swept[:, : self.skipped]
        if self.sweep_stride == 2:
            skip = upsample_view(skip, coarse.shape[-2:], (False, True))
        logits = self.fine(torch.cat([skip, coarse], 1))
        alike = skip[:, : self.groups * self.spheres.count].unflatten(1, (self.spheres.count, self.groups)).mean(2)
        return logits + self.trust * F.pad(alike, (0, 0, 0, 0, 0, 1))

    def sweep(
        self, features: Float[Tensor, "B N C _ _"], present: Present, rig: Rig
    ) -> tuple[Float[Tensor, "B E h w"], Bool[Tensor, "B 1 h w"]]:
        """Return the input of the 2D network, and the mask of directions that any camera sees."""
        match, context = features.split([self.match_channels, features.shape[2] - self.match_channels], 2)
        rows, blocks = table(match, present), self._samplers(match, rig, self.spheres.planes)
        parts = [similarity(rows, *pair, present, self.groups) for pair in blocks]
        agreement, *fractions = (joined(part) for part in zip(*parts, strict=True))
        one, two = (self._maps(fraction[..., None]) for fraction in fractions)
        both, either = torch.minimum(one, two).mean(1, keepdim=True), torch.maximum(one, two).mean(1, keepdim=True)
        maps = [self._maps(part) for part in (agreement, *self._views(context, present, rig))]
        inputs = [*maps, both, either, row_hint(self.swept.height, features.device).expand_as(both)]
        if self.hints:
            inputs.append(rig_hints(rig, self.swept, self.rig_spheres(rig)).to(either).expand(len(either), -1, -1, -1))
        return torch.cat(inputs, 1), either > 0

    def weighted_losses(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: Rigs,
        erp_range_m: Float[Tensor, "B h w"],
        camera_range_m: Float[Tensor, "B N H W"] | None,
        generator: torch.Generator,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name; with `hints`, half of the batches at random do not tell the road's height."""
        if self.hints and bool(torch.rand((), generator=generator) < UNTOLD):
            rigs = tuple(replace(rig, road_z_m=None) for rig in rigs)
        return super().weighted_losses(images, rigs, erp_range_m, camera_range_m, generator)

    def _views(self, context: Float[Tensor, "B N C _ _"], present: Present, rig: Rig) -> list[Float[Tensor, "P B C"]]:
        """Return the mean and the absolute difference of the features of the two sets on some spheres."""
        rows, planes = table(context, present), tuple(part * (self.spheres.count - 1) for part in CONTEXT_SPHERES)
        blocks = zip(*self._samplers(context, rig, planes), strict=True)
        one, two = (joined([sampler.mean(rows, present)[0] for sampler in side]) for side in blocks)
        return [(one + two) / 2, (one - two).abs()]

    def _samplers(
        self, features: Float[Tensor, "B N C _ _"], rig: Rig, planes: tuple[float, ...]
    ) -> Iterator[tuple[Sampler, Sampler]]:
        size = features.shape[-1], features.shape[-2]
        spheres = self.rig_spheres(rig)
        if self.pairs == "nearest":
            everyone = Projection(self.swept, spheres, size, tuple(range(len(rig.cameras))), planes)
            return iter(divided_samplers(rig, everyone, features.device))
        sweeps = [Projection(self.swept, spheres, size, cameras, planes) for cameras in alternate_cameras(rig)]
        return zip(*(samplers(rig, sweep, features.device) for sweep in sweeps), strict=True)

    def _maps(self, points: Float[Tensor, "P B C"]) -> Float[Tensor, "B DC h w"]:
        """Lay points of all spheres, in the order of spheres, rows and columns, out as maps."""
        shape = (-1, self.swept.height, self.swept.width)
        return points.unflatten(0, shape).permute(3, 0, 4, 1, 2).flatten(1, 2)
