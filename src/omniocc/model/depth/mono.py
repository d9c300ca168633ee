"""Range estimated in each camera's image and merged into one panorama: the baseline that uses no overlap."""

import math

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor
from torch.nn import functional as F

from omniocc.bounds import Size, Weight
from omniocc.camera import Equirectangular, Rig
from omniocc.camera.ops.pixels import pixel_centers
from omniocc.errors import UserError
from omniocc.loss import SILog
from omniocc.model.ops.depth.depth_map import DepthMap, from_index
from omniocc.model.ops.depth.layers import FeatureNet
from omniocc.model.ops.depth.panorama_depth import DepthBatch, LearnedPanoramaDepth
from omniocc.model.ops.depth.projection import present_cameras
from omniocc.model.ops.depth.spheres import SphereRange
from omniocc.model.ops.depth.z_buffer import SAME_SURFACE, draw_front
from omniocc.model.ops.padded import frame_size
from omniocc.model.ops.rig_cache import once_per_rig

TYPICAL_M = 8.0
"""Range for which the network's output is zero."""
HOLE_PASSES = 2


@once_per_rig
def camera_rays(
    rig: Rig, size: tuple[int, int], device: torch.device
) -> tuple[Float32[Tensor, "N height width 3"], Bool[Tensor, "N height width"]]:
    """Return ego-frame directions of the pixels of maps of `size` (width, height), and the mask of seen ones.

    The maps span the rig's largest image; smaller ones are padded (`omniocc.model.ops.padded`).
    """
    frame = frame_size(rig)
    rays, seen = [], []
    for k, camera in enumerate(rig.cameras):
        width, height = camera.width * size[0] // frame[0], camera.height * size[1] // frame[1]
        masks = rig.masks and rig.masks[k : k + 1]
        single = Rig((camera,), rig.ego_from_camera[k : k + 1], rig.names[k : k + 1], masks).resized(width, height)
        camera_directions, camera_seen = single.rays(0)
        padding = (0, size[0] - width, 0, size[1] - height)
        rays.append(F.pad(camera_directions, (0, 0, *padding)))
        seen.append(F.pad(camera_seen, padding))
    return torch.stack(rays).to(device), torch.stack(seen).to(device)


def fill_holes(range_m: Float[Tensor, "B h w"], passes: int) -> Float[Tensor, "B h w"]:
    """Fill pixels without a range (inf) with the farthest of their four neighbours' ranges, `passes` times.

    The farthest is used since holes are beside the edges of near objects, where the background becomes visible.
    """
    for _ in range(passes):
        sides = [range_m.roll(1, -1), range_m.roll(-1, -1)]
        edge = torch.full_like(range_m[:, :1], float("inf"))
        sides += [torch.cat([edge, range_m[:, :-1]], 1), torch.cat([range_m[:, 1:], edge], 1)]
        around = torch.stack(sides)
        farthest = torch.where(around.isinf(), -1.0, around).amax(0)
        range_m = torch.where(range_m.isinf() & (farthest > 0), farthest, range_m)
    return range_m


def merge_cameras(
    range_m: Float[Tensor, "B N H W"],
    value: Float[Tensor, "B N H W"],
    drawn: Bool[Tensor, "B N H W"],
    rig: Rig,
    panorama: Equirectangular,
    depth_ratio: float = SAME_SURFACE,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return ranges from the ego origin, and values, from ranges from the cameras' own centres; see `draw_front`.

    Maps span the images, ranges are finite; pixels in `drawn` are used where lens and mask let the camera see.
    """
    rays, seen = camera_rays(rig, (range_m.shape[-1], range_m.shape[-2]), range_m.device)
    centers_m = rig.ego_from_camera[:, :3, 3].to(rays)
    points_m = centers_m[:, None, None] + range_m[..., None] * rays
    return draw_front(points_m.flatten(1, 3), value.flatten(1), (drawn & seen).flatten(1), panorama, depth_ratio)


@once_per_rig
def ray_maps(rig: Rig, device: torch.device) -> Float[Tensor, "N 4 H W"]:
    """Return every pixel's unit ray in the camera's own frame and the sine of its elevation in the ego frame.

    Smaller images than the rig's largest are padded by zeros.
    """
    frame = frame_size(rig)
    maps = []
    for k, camera in enumerate(rig.cameras):
        rays, _ = camera.unproject(pixel_centers(camera.width, camera.height, torch.float64))
        up = rays @ rig.ego_from_camera[k, 2, :3]
        padding = (0, frame[0] - camera.width, 0, frame[1] - camera.height)
        maps.append(F.pad(torch.cat([rays, up[..., None]], -1).movedim(-1, 0).float(), padding))
    return torch.stack(maps).to(device)


class Mono(LearnedPanoramaDepth):
    """Estimate the log of the range and the sky in each image, from its colours and the rays of its pixels.

    Maps of all cameras, at half the size of the images, are drawn into the panorama from the cameras' positions, the
    nearest surface in front. Other arguments as in `LearnedPanoramaDepth`.

    Args:
        channels: per level of the network, finest (half the image size) first; multiples of 8.
        focus: of the scale-invariant loss, see `SILog`.
        sky_weight: of the cross-entropy of sky, added to it.
    """

    def __init__(
        self,
        panorama: Equirectangular,
        spheres: SphereRange,
        channels: list[Size],
        focus: float,
        sky_weight: Weight,
        mirror: bool,
    ):
        super().__init__(panorama, spheres, mirror)
        self.sky_weight = sky_weight
        self.net = FeatureNet(channels, out_channels=2, extra_channels=4)
        self.silog = SILog(focus)

    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        log_range, sky = self.camera_ranges(images, (rig,) * len(images))
        spheres = self.rig_spheres(rig)
        range_m = log_range.exp().clamp(max=spheres.farthest_m)
        present, solid = present_cameras(images)[:, :, None, None].expand_as(range_m), (-sky).sigmoid()
        surface, _ = merge_cameras(range_m, solid, present & (solid > 0.5), rig, self.panorama)
        # where the sky is likely: the range that would hold for a surface
        guess, _ = merge_cameras(range_m, solid, present, rig, self.panorama)
        range_or_sky_m = torch.where(solid > 0.5, range_m, spheres.farthest_m)
        _, confidence = merge_cameras(range_or_sky_m, solid, present, rig, self.panorama, depth_ratio=math.inf)
        filled = fill_holes(guess, HOLE_PASSES)
        valid = (surface.isfinite() & (confidence > 0.5)) | (guess.isinf() & filled.isfinite())
        index = spheres.index(torch.where(surface.isfinite(), surface, filled))
        return from_index(index, valid, confidence, spheres)

    def losses(self, batch: DepthBatch, flip: bool) -> dict[str, Float[Tensor, ""]]:
        """Return the losses `silog` and `sky`, which use only the ranges of single cameras.

        Raises:
            UserError: if there are no ranges of cameras.
        """
        if batch.camera_range_m is None:
            raise UserError("model/depth=mono learns from the range of every camera; this data has none")
        log_range, sky = self.camera_ranges(batch.images, batch.rigs, flip)
        true_m = range_of_four(batch.camera_range_m)
        known = ~true_m.isnan()
        wrong = F.binary_cross_entropy_with_logits(sky, true_m.isinf().to(sky), reduction="none")
        entropy = torch.where(known, wrong, 0).sum() / known.sum().clamp(min=1)
        return {"silog": self.silog(log_range, true_m), "sky": self.sky_weight * entropy}

    def camera_ranges(
        self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...], flip: bool = False
    ) -> tuple[Float[Tensor, "B N _ _"], Float[Tensor, "B N _ _"]]:
        """Return the log of the range (m) from each camera's centre and the logit of sky, at half size.

        The images have one shape, without padding; if `flip`, they are mirrored, and with them the results.
        """
        rays = torch.stack([ray_maps(rig, images.device) for rig in rigs])
        if flip:
            images, rays = images.flip(-1), rays.flip(-1) * rays.new_tensor([-1, 1, 1, 1])[:, None, None]
        log_range, sky = self.net(images, rays).float().unbind(2)
        return log_range + math.log(TYPICAL_M), sky


def range_of_four(range_m: Float[Tensor, "B N H W"]) -> Float[Tensor, "B N _ _"]:
    """Return the harmonic mean range of each 2x2 block; inf where three or four are inf, nan where any is unknown."""
    inverse = 4 * F.avg_pool2d(range_m.nan_to_num(1.0, posinf=torch.inf).reciprocal(), 2)
    surfaces = 4 * F.avg_pool2d((~range_m.isinf()).to(range_m), 2)
    blocks = torch.where(surfaces > 1, surfaces / inverse, torch.inf)
    return torch.where(F.max_pool2d(range_m.isnan().to(range_m), 2) > 0, torch.nan, blocks)
