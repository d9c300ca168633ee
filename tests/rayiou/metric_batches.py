"""The five metrics, with a batch of each."""

import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import CalibrationError, CandidateScores, DepthMetrics, RayIoU, VoxelIoU

GRID = Cylinder((8, 12, 4), (0.0, 12.0), (-2.8, 3.2))
LINE = Cuboid((10, 1, 1), (0.0, 10.0), (-0.5, 0.5), (-0.5, 0.5))
FORWARD = torch.tensor([[1.0, 0.0, 0.0]])
METRICS = {
    "rays": (RayIoU, {"grid": GRID}),
    "voxels": (VoxelIoU, {}),
    "depth": (DepthMetrics, {}),
    "calibration": (CalibrationError, {}),
    "candidates": (CandidateScores, {"grid": GRID}),
}


def batch(name, seed=0):
    """Return predictions and truth of two samples as one of the metrics takes them."""
    generator = torch.Generator().manual_seed(seed)
    target = torch.randint(0, 12, (2, *GRID.shape), generator=generator, dtype=torch.uint8)
    target[torch.rand(target.shape, generator=generator) < 0.8] = 0
    preds, fraction = target.roll(1, 1), torch.rand(target.shape, generator=generator)
    return {
        "rays": (preds, target),
        "voxels": (preds, target),
        "depth": (fraction + 2, fraction * 9 + 1),
        "calibration": (fraction, fraction > 0.4),
        "candidates": (preds > 0, target),
    }[name]


def same(left, right):
    assert left.keys() == right.keys()
    for key, value in left.items():
        torch.testing.assert_close(value, right[key], rtol=0, atol=0, equal_nan=True)


def made(name, **kwargs):
    kind, arguments = METRICS[name]
    return kind(**arguments, **kwargs)


def counted(name, *seeds):
    metric = made(name)
    for seed in seeds:
        metric.update(*batch(name, seed))
    return metric
