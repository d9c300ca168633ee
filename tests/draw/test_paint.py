import numpy as np
import torch

from omniocc.camera import Equidistant, Equirectangular, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.classes import WORLD_CLASSES
from omniocc.draw.paint import BACKGROUND, paint_voxels, voxel_panorama
from omniocc.geometry import Cuboid

GRID = Cuboid((20, 20, 6), (-10.0, 10.0), (-10.0, 10.0), (-3.0, 3.0))  # cells of 1 m
CAMERAS = (Equidistant(80, 80, 25.0, (39.5, 39.5), 80.0),) * 2
POSES = torch.stack([pose_from_angles((0.0, 0.0, 0.0), yaw, 0.0, 0.0) for yaw in (0.0, 90.0)])
RIG = Rig(CAMERAS, POSES, ("front", "left"))


def one_voxel(x, y, z, label=7):
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    index, inside = GRID.index(torch.tensor([x, y, z]))
    assert inside
    labels[tuple(index.tolist())] = label
    return labels


def colored(image):
    """Return which pixels are not grey."""
    return image.max(2).astype(int) - image.min(2) > 20


def test_a_voxel_is_painted_where_its_cell_is_seen():
    labels = one_voxel(5.5, 2.5, 0.5)
    images = [np.full((80, 80, 3), 120, np.uint8)] * 2
    front, left = paint_voxels(images, RIG, labels, GRID, WORLD_CLASSES, 80)
    centre = torch.tensor([[5.5, 2.5, 0.5]]).double()
    pixels, _ = RIG.project(centre)
    u, v = pixels[0, 0].round().long().tolist()
    assert colored(front)[v, u]
    assert u < 39
    assert v < 39  # to the left of and above the axis
    # a cell of 1 m at 6.1 m spans about a sixth of a radian, that is 4 px, in steps of two pixels
    rows, columns = np.nonzero(colored(front))
    assert rows.max() - rows.min() <= 7
    assert columns.max() - columns.min() <= 7
    u, v = pixels[1, 0].round().long().tolist()
    assert colored(left)[v, u]
    red, green, blue = front[colored(front)].mean(0)
    assert red > 2 * green
    assert red > 2 * blue


def test_near_voxels_hide_far_ones_and_unknown_ones_do_not():
    far = one_voxel(7.5, 0.5, 0.5, label=7)
    images = [np.full((80, 80, 3), 120, np.uint8)] * 2
    for label, hidden in ((4, True), (255, False)):
        labels = torch.maximum(far, torch.zeros_like(far))
        near = one_voxel(3.5, 0.5, 0.5, label=label)
        labels[near > 0] = label
        front = paint_voxels(images, RIG, labels, GRID, WORLD_CLASSES, 80)[0]
        assert colored(front).any() != hidden


def test_masked_pixels_have_no_voxels():
    mask = torch.ones(80, 80, dtype=torch.bool)
    mask[:, 40:] = False
    labels = torch.full(GRID.shape, 7, dtype=torch.uint8)
    images = [np.full((80, 80, 3), 120, np.uint8)] * 2
    half = Rig(CAMERAS, POSES, RIG.names, (mask, None))
    front, left = paint_voxels(images, half, labels, GRID, WORLD_CLASSES, 80)
    assert colored(front)[20:60, 20:38].all()
    assert not colored(front)[:, 42:].any()
    assert colored(left)[20:60, 20:60].all()


def test_the_panorama_has_the_class_of_the_first_voxel():
    labels = one_voxel(0.5, 6.5, 0.5)  # to the left: a quarter from the left edge
    image = voxel_panorama(labels, GRID, WORLD_CLASSES, Equirectangular(48, 12, 45.0, -45.0), 480)
    assert image.shape == (60, 240, 3)
    rows, columns = np.nonzero((image == WORLD_CLASSES.palette[7]).all(2))
    # x from 0 to 1 m, y from 6 to 7 m: from straight left to atan(1 / 6) ahead of it
    assert columns.min() == 60
    assert 64 <= columns.max() <= 66
    assert rows.max() < 31
    assert (image[50, 60] == BACKGROUND).all()
