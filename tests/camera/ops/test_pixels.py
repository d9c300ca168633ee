import torch
from torch.nn import functional as F

from omniocc.camera import normalize_pixels
from omniocc.camera.ops.pixels import usable


def test_grid_sample_reads_the_pixel_itself():
    image = torch.rand(1, 3, 5, 7)
    pixels = torch.tensor([[0.0, 0.0], [6.0, 4.0], [2.0, 3.0]])
    grid = normalize_pixels(pixels, width=7, height=5)
    sampled = F.grid_sample(image, grid[None, None], align_corners=False)[0, :, 0]
    for k, (u, v) in enumerate(pixels.long().tolist()):
        torch.testing.assert_close(sampled[:, k], image[0, :, v, u])


def test_image_spans_minus_one_to_one():
    corners = torch.tensor([[-0.5, -0.5], [6.5, 4.5], [3.0, 2.0]], dtype=torch.float64)
    assert normalize_pixels(corners, 7, 5).tolist() == [[-1, -1], [1, 1], [0, 0]]


def test_pixels_are_usable_by_the_nearest_pixel_of_the_mask():
    """At the border the nearest pixel is one of the image; a pixel that is not valid may be anything."""
    mask = torch.tensor([[True, False], [False, True]])
    pixels = torch.tensor([[-0.5, -0.5], [0.4, 0.6], [1.5, 1.5], [0.0, 0.0], [torch.nan, 0.0]])
    valid = torch.tensor([True, True, True, False, False])
    assert usable(mask, pixels, valid).tolist() == [True, False, True, False, False]
    assert usable(None, pixels, valid) is valid
