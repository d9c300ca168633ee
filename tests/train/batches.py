"""Batches of windows whose content is a function of scene and frame, at the size of `preset=smoke`."""

import torch

from omniocc.batch import Batch
from omniocc.camera import Rig
from rayiou.directions import rays_around

RIG = Rig.load("fisheye6").resized(64, 36)
BESIDE = {
    "model/refiner=experts": "loss=with_coarse",
    "model/lifter=coarse_to_fine": "loss=with_coarse",
    "model/geometry=occ3d": "model.geometry.shape=[50,50,8]",
}
"""What stands beside an option here: losses of all that it predicts, where the paper's are not enough; fewer voxels."""


WAYS = ("camera", "rig", "scale", "image")
"""What may be wrong in a batch of `augment=disturbed`."""


def always(way):
    """Return the overrides with which this is wrong in every batch, and nothing else."""
    return [f"augment.disturbances.{other}_probability={float(other == way)}" for other in WAYS]


def make_batch(task, samples, with_candidates=True):
    """Return a batch of windows, whose newest frames are given as (scene, number)."""
    shape, frames = task.model.geometry.shape, task.model.temporal.frames

    def frame(scene, number):
        generator = torch.Generator().manual_seed(1000 * scene + number)
        pose = torch.eye(4, dtype=torch.float64)
        pose[0, 3] = 2.3 * number
        images = torch.randint(0, 256, (6, 3, 36, 64), generator=generator, dtype=torch.uint8)
        marked = torch.rand(shape, generator=generator) < 0.4
        voxels = torch.randint(0, 12, shape, generator=generator) * (torch.rand(shape, generator=generator) < 0.2)
        labels = torch.randint(0, 12, (6, 36, 64), generator=generator, dtype=torch.uint8)
        return images, pose, marked, voxels.to(torch.uint8), labels

    windows = [[frame(scene, max(0, number - back)) for back in reversed(range(frames))] for scene, number in samples]
    images, poses, marked = (torch.stack([torch.stack([f[k] for f in w]) for w in windows]) for k in range(3))
    ends = 9 * rays_around(10).float().expand(len(samples), -1, -1)
    return Batch(
        images=images,
        rigs=((RIG,) * frames,) * len(samples),
        world_from_ego=poses,
        voxels=torch.stack([w[-1][3] for w in windows]),
        pixel_labels=torch.stack([w[-1][4] for w in windows]),
        lidar_range_m=torch.full((len(samples), 14040), 5.0),
        lidar_labels=torch.ones(len(samples), 14040, dtype=torch.uint8),
        scan_origins=torch.zeros_like(ends),
        scan_ends=ends,
        scan_labels=(torch.arange(ends.shape[1]) % 12).to(torch.uint8).expand(len(samples), -1),
        frame_ids=tuple(f"{scene}/{number:06d}" for scene, number in samples),
        candidates=marked if with_candidates else None,
        evidence=(marked * 200).to(torch.uint8) if with_candidates else None,
        exists=torch.tensor([[number >= back for back in reversed(range(frames))] for _, number in samples]),
    )
