"""A batch of samples with different cameras, images and labels: present and filled parts."""

import pytest
import torch
from fake_source import GRID, FakeSource

from omniocc.data.augment.augment import Change, change_scenes, mirror_columns
from omniocc.data.augment.image import erase, jitter
from omniocc.data.dataset import WindowDataset, collate, pad_stack


@pytest.fixture
def data(tmp_path):
    source = FakeSource(str(tmp_path), with_lidar=True)
    return WindowDataset(source.scenes("train"), source.labels(GRID, "none"), window=2, own_rays=True)


@pytest.fixture
def batch(data):
    """Return a batch of scene 0, frame 1 (4 cameras), scene 1, frames 0 and 2 (3 cameras, the last without voxels)."""
    return collate([data[1], data[3], data[5]])


def test_images_are_padded_at_the_end_and_the_mask_shows_where(batch, data):
    assert batch.images.shape == (3, 2, 4, 3, 36, 64)
    mask = batch.image_mask()
    assert mask.shape == (3, 2, 4, 36, 64)
    assert mask[0].all()
    assert mask[1].flatten(2).sum(2).tolist() == [[48 * 32, 64 * 24, 32 * 32, 0]] * 2
    assert mask[1, 0, 0, :32, :48].all()
    assert (batch.images.amin(3) > 0).eq(mask).all()  # the source's images have no zeros
    for k, image in enumerate(data.scenes[1].images(2)):
        height, width = image.shape[:2]
        assert torch.equal(batch.images[2, 1, k, :, :height, :width], torch.from_numpy(image).permute(2, 0, 1))


def test_every_frame_has_its_own_rig(batch, data):
    rigs = data.scenes[1].rigs
    assert batch.rigs[2] == (rigs[1], rigs[2])
    assert rigs[1] != rigs[2]
    assert batch.newest_rigs == (data.scenes[0].rigs[1], rigs[0], rigs[2])


def test_a_field_missing_in_one_sample_is_unknown_and_in_all_is_absent(batch):
    assert (batch.voxels[2] == 255).all()
    assert (batch.voxels[:2] < 19).all()
    assert batch.pixel_labels is batch.erp_range_m is batch.camera_range_m is batch.candidates is None
    assert batch.lidar_range_m.shape == (3, 32)
    assert (batch.lidar_labels == 255).sum(1).tolist() == [1, 2, 0]
    assert batch.lidar_directions[0, :31].norm(dim=-1).allclose(torch.ones(31))
    assert (batch.lidar_directions[0, 31:] == 0).all()


def test_tensors_are_padded_at_the_end_of_every_axis():
    stacked = pad_stack([torch.ones(2, 1), torch.zeros(1, 3)], float("nan"))
    assert stacked.isnan().tolist() == [[[False, True, True]] * 2, [[False] * 3, [True] * 3]]
    assert stacked.nansum() == 2


def test_images_are_mirrored_within_their_own_width(batch):
    mirrored = change_scenes(batch, GRID, [Change(flip=True)] * 3)
    assert torch.equal(mirrored.image_mask(), batch.image_mask())
    assert torch.equal(mirrored.images[1, 0, 0, :, :32, :48], batch.images[1, 0, 0, :, :32, :48].flip(-1))
    assert torch.equal(mirrored.images[0], batch.images[0].flip(-1))
    back = change_scenes(mirrored, GRID, [Change(flip=True)] * 3)
    assert torch.equal(back.images, batch.images)
    assert back.rigs == batch.rigs


def test_columns_beyond_the_width_stay():
    values = torch.tensor([[1, 2, 3, 0], [1, 2, 3, 4]])
    assert mirror_columns(values, torch.tensor([3, 4])).tolist() == [[3, 2, 1, 0], [4, 3, 2, 1]]


def test_colors_and_boxes_do_not_change_padding(batch):
    mask = batch.image_mask()
    generator = torch.Generator().manual_seed(0)
    jittered = jitter(batch.images, 0.3, 0.3, 0.3, 10.0, generator, mask)
    assert (jittered.amax(3)[~mask] == 0).all()
    single = batch.images[:, :, :1, :, :24, :32].contiguous()
    same = (
        jitter(single, 0.0, 0.4, 0.0, 0.0, torch.Generator().manual_seed(1), m)
        for m in (None, mask[:, :, :1, :24, :32])
    )
    assert torch.equal(*same)
    erased, lost = erase(batch.images, 1.0, (0.2, 0.3), (0.5, 2.0), generator, batch.image_sizes())
    assert not (lost & ~mask).any()
    assert (erased.amax(3)[~mask] == 0).all()
    fraction = lost.flatten(3).sum(3) / mask.flatten(3).sum(3).clamp(min=1)
    assert fraction[1, 0, :3].min() > 0.15
    assert fraction.max() < 0.35
