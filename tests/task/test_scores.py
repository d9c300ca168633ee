"""Every grid is judged on the same LiDAR rays."""

import torch

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import sparseocc_directions
from omniocc.task.scores import Scores, within_reach


def test_hits_beyond_the_last_band_count_for_no_grid():
    directions = torch.tensor([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    range_m = torch.tensor([[25.5, 40.0, 25.7]])
    labels = torch.tensor([[4, 5, 6]], dtype=torch.uint8)
    assert within_reach(labels, range_m, directions).tolist() == [[4, 5, 0]]


def test_cuboid_and_cylinder_are_judged_on_the_same_rays():
    generator = torch.Generator().manual_seed(0)
    rays = len(sparseocc_directions())
    range_m = torch.empty(2, rays).uniform_(1, 36, generator=generator)
    hits = torch.randint(0, 12, (2, rays), generator=generator, dtype=torch.uint8)
    counts = []
    for grid in (Cylinder((8, 12, 4)), Cuboid((10, 10, 4))):
        scores = Scores(grid)
        labels = torch.zeros(2, *grid.shape, dtype=torch.uint8)
        images, poses = torch.zeros(2, 1, 6, 3, 4, 4, dtype=torch.uint8), torch.eye(4).double().expand(2, 1, 4, 4)
        pixels, rigs = torch.zeros(2, 6, 4, 4, dtype=torch.uint8), (Rig.load("fisheye6"),) * 2
        scores.update(labels, Batch(images, rigs, poses, labels, pixels, range_m, hits, ("a/0", "a/1")))
        counts.append(scores.lidar.truth)
    assert counts[0].sum() > 1000
    assert torch.equal(counts[0], counts[1])
