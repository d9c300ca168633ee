import torch

from omniocc.camera import normalize_pixels
from omniocc.geometry import Cylinder
from omniocc.model.ops.static import static_shapes
from omniocc.model.ops.voxel_samples import sample_at_voxels

GRID = Cylinder((6, 8, 3))
CLASSES = 5


def make_logits(batch: int) -> torch.Tensor:
    return torch.randn(batch, 6, CLASSES, 9, 16, dtype=torch.float64)


def by_grid_sample(logits, marked, rig):
    """The mean over cameras of `grid_sample` at the voxels' middles, for one sample."""
    pixels, valid = rig.project(GRID.centers(torch.float64).reshape(-1, 3))
    total = torch.zeros(GRID.num_cells, CLASSES, dtype=torch.float64)
    for camera in range(len(rig.cameras)):
        model = rig.cameras[camera]
        points = normalize_pixels(pixels[camera], model.width, model.height)
        found = torch.nn.functional.grid_sample(logits[camera : camera + 1], points[None, None], align_corners=False)
        total += torch.where(valid[camera, :, None], found[0, :, 0].T, 0)
    mean = total / valid.sum(0).clamp(min=1)[:, None]
    return (mean * marked.flatten()[:, None]).T.reshape(CLASSES, *GRID.shape)


def test_equals_grid_sample_over_mixed_rigs(fisheye, pinhole):
    logits, candidates = make_logits(3), torch.rand(3, *GRID.shape) < 0.6
    rigs = (fisheye, pinhole, fisheye)
    result = sample_at_voxels(logits, candidates, rigs, GRID, 4)
    assert result.shape == (3, CLASSES, *GRID.shape)
    for index, rig in enumerate(rigs):
        # reference points are kept in float32
        expected = by_grid_sample(logits[index], candidates[index], rig)
        torch.testing.assert_close(result[index], expected, rtol=1e-5, atol=1e-5)


def test_no_candidates_give_zeros(fisheye):
    result = sample_at_voxels(make_logits(1), torch.zeros(1, *GRID.shape, dtype=torch.bool), (fisheye,), GRID, 4)
    assert not result.any()


def test_fixed_shapes_give_the_same(fisheye):
    logits, candidates = make_logits(1), torch.rand(1, *GRID.shape) < 0.4
    expected = sample_at_voxels(logits, candidates, (fisheye,), GRID, 4)
    with static_shapes():
        torch.testing.assert_close(sample_at_voxels(logits, candidates, (fisheye,), GRID, 4), expected)


def test_the_gradient_reaches_the_pixels_that_are_seen(fisheye):
    logits = make_logits(1).requires_grad_()
    sample_at_voxels(logits, torch.ones(1, *GRID.shape, dtype=torch.bool), (fisheye,), GRID, 4).sum().backward()
    assert logits.grad is not None
    per_camera = logits.grad.flatten(2).abs().sum((0, 2))
    assert (per_camera > 0).all()
    # every voxel's mean over cameras has weight 1 in each class, except at the border of the images
    assert 0 < float(logits.grad.sum()) <= GRID.num_cells * CLASSES + 1e-6
