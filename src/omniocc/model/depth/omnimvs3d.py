"""Omnidirectional depth by a cost volume over all cameras and 3D regularisation (OmniMVS, Won et al. 2019)."""

from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import CountOrNone, Fraction, Size
from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.layers import FeatureNet
from omniocc.model.ops.depth.projection import Present, Projection, samplers, table
from omniocc.model.ops.depth.sphere_net import SphereLoss, SphereNet
from omniocc.model.ops.depth.spheres import SphereRange
from omniocc.model.ops.padding import Conv3d, Downsample, Pointwise, residual3d, upsample

AROUND = (False, False, True)
"""Periodic axes among spheres, rows and columns."""


class OmniMVS3D(SphereNet):
    """Regularise mean and variance over all cameras of the features on every sphere by a 3D encoder-decoder.

    The paper concatenates the features of its four cameras; mean and variance take any number in any order (MVSNet, Yao
    et al. 2018), also with a camera missing. The variance is small where the cameras agree.

    Other arguments as in `SphereNet`.

    Args:
        feature_channels: per level of the feature network, finest (half the image size) first; multiples of 8.
        match_channels: features whose mean and variance go into the volume.
        sweep_stride: panorama pixels per swept point along each side.
        channels: per level of the 3D network, finest first; multiples of 8.

    Raises:
        ValueError: if the panorama cannot be halved often enough.
    """

    def __init__(
        self,
        panorama: Equirectangular,
        spheres: SphereRange,
        loss: SphereLoss,
        feature_channels: list[Size],
        match_channels: Size,
        sweep_stride: int,
        channels: list[Size],
        window: CountOrNone,
        min_confidence: Fraction,
        mirror: bool,
    ):
        super().__init__(panorama, spheres, loss, window, min_confidence, mirror)
        width, height = panorama.width, panorama.height
        multiple = sweep_stride * 2 ** (len(channels) - 1)
        if width % multiple or height % sweep_stride:
            raise ValueError(
                f"the panorama is {width}x{height} px; {len(channels)} levels and sweep_stride {sweep_stride} "
                f"need a width in multiples of {multiple} and a height in multiples of {sweep_stride}"
            )
        self.swept = panorama.resized(width // sweep_stride, height // sweep_stride)
        self.features = FeatureNet(feature_channels, match_channels)
        self.net = VolumeNet(2 * match_channels, channels)

    def scores(self, swept: Float[Tensor, "B C D _ _"]) -> Float[Tensor, "B E h w"]:
        """Return scores of spheres and sky by the 3D network."""
        return resize_panorama(self.net(swept), self.panorama.height, self.panorama.width)

    def sweep(
        self, features: Float[Tensor, "B N C _ _"], present: Present, rig: Rig
    ) -> tuple[Float[Tensor, "B E D h w"], Bool[Tensor, "B 1 h w"]]:
        """Return mean and variance on all spheres, and the mask of directions that any camera sees."""
        features = features.float()  # in half precision the variance, a difference of squares, would be rounding noise
        rows = table(torch.cat([features, features.square()], 2), present)
        size = features.shape[-1], features.shape[-2]
        cameras = tuple(range(len(rig.cameras)))
        projection = Projection(self.swept, self.rig_spheres(rig), size, cameras, self.spheres.planes)
        blocks = [sampler.mean(rows, present) for sampler in samplers(rig, projection, features.device)]
        means, fractions = (torch.cat(parts) for parts in zip(*blocks, strict=True))
        mean, square = means.chunk(2, -1)
        moments = torch.cat([mean, square - mean.square()], -1)
        shape = (self.spheres.count, self.swept.height, self.swept.width)
        seen = fractions.gt(0).unflatten(0, shape).any(0).permute(2, 0, 1)[:, None]
        return moments.unflatten(0, shape).permute(3, 4, 0, 1, 2), seen


class VolumeNet(nn.Module):
    """Encode and decode a volume of (spheres, rows, columns) with added skips; wraps around along the columns.

    The sky's score is a mean over spheres.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8.
    """

    def __init__(self, in_channels: int, channels: list[int]):
        super().__init__()
        pairs = list(pairwise(channels))
        self.stem = Conv3d(in_channels, channels[0], 3, AROUND)
        self.encoder = nn.ModuleList(residual3d(count, AROUND) for count in channels)
        self.down = nn.ModuleList(Downsample(fine, coarse, AROUND) for fine, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(residual3d(fine, AROUND) for fine, _ in pairs)
        self.out = Conv3d(channels[0], 2, 3, AROUND)

    def forward(self, volume: Float[Tensor, "B C D h w"]) -> Float[Tensor, "B E h w"]:
        """Return in every direction one score for every sphere, and last the sky's."""
        volume = self.encoder[0](self.stem(volume.contiguous(memory_format=torch.channels_last_3d)))
        skips = []
        for down, block in zip(self.down, list(self.encoder)[1:], strict=True):
            skips.append(volume)
            volume = block(down(volume))
        for up, block, skip in reversed(list(zip(self.up, self.decoder, skips, strict=True))):
            volume = block(skip + upsample(up(volume), skip.shape[2:], AROUND))
        scores, sky = self.out(volume).unbind(1)
        return torch.cat([scores, sky.mean(1, keepdim=True)], 1)


def resize_panorama(maps: Float[Tensor, "B D _ _"], height: int, width: int) -> Float[Tensor, "B D h w"]:
    """Interpolate bilinearly to a whole multiple of the size, across the seam."""
    factor = width // maps.shape[-1]
    if factor == 1:
        return maps
    wrapped = F.pad(maps, (1, 1, 0, 0), mode="circular")
    fine = F.interpolate(wrapped, size=(height, width + 2 * factor), mode="bilinear", align_corners=False)
    return fine[..., factor : factor + width]
