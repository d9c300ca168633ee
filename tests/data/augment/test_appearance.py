import pytest
import torch

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.data import Appearance
from omniocc.data.augment.appearance import _jpeg, missing_ones
from omniocc.data.augment.degrade import compress_jpeg

OFF = dict.fromkeys(
    ("exposure", "gamma", "white_balance", "grey", "blur_px", "noise", "vignette", "glare", "jpeg", "missing"), 0.0
)
MASK = torch.ones(2, 4, 24, 32, dtype=torch.bool)


def images():
    smooth = torch.rand(2, 4, 3, 6, 8, generator=torch.Generator().manual_seed(1))
    return torch.nn.functional.interpolate(smooth.flatten(0, 1), scale_factor=4, mode="bilinear").unflatten(0, (2, 4))


def changed(seed=0, **limits):
    return Appearance(**(OFF | limits)).change(images(), MASK, torch.Generator().manual_seed(seed))


def test_off_changes_nothing():
    torch.testing.assert_close(changed(), images(), atol=2e-4, rtol=0)


@pytest.mark.parametrize(
    "limits",
    [{name: {"jpeg": 1.0, "blur_px": 3.0}.get(name, 0.5)} for name in OFF if name not in ("grey", "missing")],
    ids=lambda limits: next(iter(limits)),
)
def test_each_change_changes_and_depends_only_on_the_generator(limits):
    results = [changed(seed, **limits) for seed in range(4)]
    assert torch.equal(results[0], changed(0, **limits))
    alike = [float(torch.corrcoef(torch.stack([one.flatten(), images().flatten()]))[0, 1]) for one in results]
    assert 0.3 < min(alike) < 0.9999
    assert len(set(alike)) > 1
    assert all(one.min() >= 0 and one.max() <= 1 for one in results)


def test_cameras_of_a_rig_differ_by_less_than_it():
    result = changed(0, exposure=1.0)
    stops = (result / images()).log2().masked_fill(result > 0.99, torch.nan).flatten(2).nanmedian(2).values
    assert (stops.amax(1) - stops.amin(1) <= 1.0).all()
    assert stops.std(1).min() > 0
    assert (stops.mean(1) - stops.mean()).abs().min() > 0.01


def test_grey_rigs_have_equal_channels():
    result = changed(grey=1.0)
    assert torch.allclose(result[:, :, 0], result[:, :, 1], atol=1e-3)
    assert torch.allclose(result[:, :, 0], result[:, :, 2], atol=1e-3)


def test_all_frames_of_a_window_change_alike_and_a_single_one_as_its_images_do():
    rig = Rig.load("fisheye6").resized(32, 18)
    batch = Batch((images()[:, :, :, :18] * 255).byte()[:, None], ((rig,),) * 2, torch.eye(4)[None, None], ("a", "b"))
    batch = batch._replace(images=batch.images.repeat(1, 1, 2, 1, 1, 1)[:, :, :6])
    change = Appearance(**(OFF | {"exposure": 1.0, "noise": 0.1, "missing": 1.0}))
    alone = change(batch, torch.Generator().manual_seed(3)).images
    expected = change.change(batch.images[:, 0] / 255, batch.image_mask()[:, 0], torch.Generator().manual_seed(3))
    assert torch.equal(alone[:, 0], expected)
    window = batch._replace(images=batch.images.expand(-1, 3, -1, -1, -1, -1), rigs=((rig,) * 3,) * 2)
    generator = torch.Generator().manual_seed(3)
    assert torch.equal(change(window, generator).images, alone.expand(-1, 3, -1, -1, -1, -1))
    assert not torch.equal(generator.get_state(), torch.Generator().manual_seed(3).get_state())


def test_at_most_one_camera_of_three_or_more_is_lost():
    mask = MASK.clone()
    mask[1, 2:] = False
    lost = torch.stack([missing_ones(mask, 1.0, torch.Generator().manual_seed(seed)) for seed in range(30)])
    assert (lost[:, 0].sum(1) == 1).all()
    assert lost[:, 0].any(0).all()
    assert not lost[:, 1].any()


def test_padding_and_black_pictures_stay_black():
    mask, given = MASK.clone(), images()
    mask[0, 1, :, 20:], mask[1, 3] = False, False
    given[1, 0] = 0
    everything = {name: 0.5 for name in OFF if name != "missing"}
    result = Appearance(**(OFF | everything)).change(given * mask[:, :, None], mask, torch.Generator().manual_seed(0))
    assert not result[0, 1, :, :, 20:].any()
    assert not result[1, 3].any()
    assert not result[1, 0].any()
    assert result[0, 0].any()


@pytest.mark.parametrize(("name", "value"), [("noise", -0.1), ("jpeg", 1.5)])
def test_impossible_values_are_named(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        Appearance(**(OFF | {name: value}))


def test_jpeg_treats_red_and_blue_as_cameras_do():
    """Its chroma is not symmetric: the error of a red pattern is another than that of a blue one."""
    pattern = torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
    for channel in (0, 2):
        image = torch.zeros(1, 3, 16, 16)
        image[:, channel] = pattern
        pixels = (image[0].permute(1, 2, 0) * 255).round().byte().numpy()
        expected = torch.from_numpy(compress_jpeg(pixels, 30)).permute(2, 0, 1)[None] / 255
        torch.testing.assert_close(_jpeg(image, 30), expected)
