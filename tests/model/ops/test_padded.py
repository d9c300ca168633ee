from dataclasses import replace

import pytest
import torch
from torch.nn import functional as F

from omniocc.camera import Rig
from omniocc.geometry import Cuboid
from omniocc.model.depth.mono import camera_rays
from omniocc.model.lifter.lift_splat import find_entries
from omniocc.model.ops.padded import ImageShape, by_shape, crop, grouped, image_shape, in_batch_order
from omniocc.model.ops.visible import reference_points

CPU = torch.device("cpu")


@pytest.fixture
def rigs(make_ring):
    """Six cameras of 64x36 px and four of 48x32 px."""
    return make_ring(6), make_ring(4, 48, 32)


def test_maps_of_a_stride_are_cropped_to_the_rig(rigs):
    maps = torch.rand(2, 6, 3, 5, 8)
    assert crop(maps, rigs[0], 8).shape == (2, 6, 3, 5, 8)
    assert torch.equal(crop(maps, rigs[1], 8), maps[:, :4, :, :4, :6])
    assert image_shape(rigs[1]).at_stride(5) == ImageShape(4, 7, 10)


@pytest.mark.parametrize("shape", [(5, 36, 64), (6, 34, 64), (6, 36, 62)])
def test_a_rig_with_more_cameras_or_larger_images_is_named(rigs, shape):
    with pytest.raises(ValueError, match=rf"6 cameras of 64x36 px.* {shape[0]} cameras of {shape[2]}x{shape[1]} px"):
        crop(torch.rand(1, shape[0], 3, *shape[1:]), rigs[0])


def test_a_network_sees_no_padding_and_its_maps_are_padded_by_zeros(rigs):
    seen = []

    def network(images, own):
        seen.append((tuple(images.shape), own))
        return [F.avg_pool2d(images.flatten(0, 1), 4, ceil_mode=True).unflatten(0, images.shape[:2]) + 1]

    images, (six, four) = torch.rand(3, 6, 3, 36, 64), rigs
    (maps,) = by_shape(network, images, (four, six, four), [4])
    assert seen == [((2, 4, 3, 32, 48), (four, four)), ((1, 6, 3, 36, 64), (six,))]
    assert maps.shape == (3, 6, 3, 9, 16)
    for sample, rig in enumerate((four, six, four)):
        own = crop(images[sample : sample + 1], rig)
        torch.testing.assert_close(crop(maps[sample : sample + 1], rig, 4), network(own, (rig,))[0])
    assert not maps[0, 4:].any()
    assert not maps[0, :, :, 8:].any()
    assert not maps[0, :, :, :, 12:].any()


def test_a_batch_without_any_full_sample_keeps_the_size_of_its_maps(rigs):
    (maps,) = by_shape(lambda images, _: [images], torch.rand(2, 6, 3, 36, 64), (rigs[1], rigs[1]), [1])
    assert maps.shape == (2, 6, 3, 36, 64)


def test_results_of_groups_return_to_the_order_of_the_batch():
    values = torch.arange(10.0).view(5, 2)
    for keys in ("ababc", "aaaaa", "edcba"):
        groups = grouped(keys).values()
        assert torch.equal(in_batch_order([values[group] for group in groups], groups), values)


def mixed(rig: Rig) -> tuple[Rig, Rig]:
    """A rig whose every other camera is 48x32 px, and the same with images of 64x36 px and masks instead."""
    small = [replace(camera, width=48, height=32) if k % 2 else camera for k, camera in enumerate(rig.cameras)]
    mask = torch.zeros(36, 64, dtype=torch.bool)
    mask[:32, :48] = True
    masks = tuple(mask if k % 2 else None for k in range(len(rig.cameras)))
    return replace(rig, cameras=tuple(small)), replace(rig, masks=masks)


def test_a_smaller_camera_equals_one_masked_at_the_right_and_at_the_bottom(make_ring):
    geometry = Cuboid((8, 8, 4))
    small, masked = mixed(make_ring(6))
    for ours, expected in zip(
        reference_points(small, geometry, CPU), reference_points(masked, geometry, CPU), strict=True
    ):
        assert torch.equal(ours, expected)
    entries = (find_entries(rig, geometry, 9, 16, (2.0, 5.0), CPU) for rig in (small, masked))
    for ours, expected in zip(*entries, strict=True):
        assert torch.equal(ours, expected)
    (rays, seen), (expected_rays, expected_seen) = (camera_rays(rig, (64, 36), CPU) for rig in (small, masked))
    assert torch.equal(seen, expected_seen)
    torch.testing.assert_close(rays[seen], expected_rays[seen])
