import itertools
import math

import pytest
import torch

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.data import Augment
from omniocc.data.augment.augment import Change, change_poses, change_scenes, count_turns
from omniocc.data.augment.image import erase, jitter
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.temporal import Mean

WIDTH, HEIGHT, WINDOW = 64, 36, 3
GRIDS = {
    "cylinder": Cylinder((6, 20, 4)),
    "ring": Cylinder((5, 12, 3), (1.0, 20.0), (-2.0, 2.0)),
    "cuboid": Cuboid((8, 8, 4)),
}
CHANGES = {
    "flip": Change(flip=True),
    "quarter": Change(steps=1, parts=4),
    "three quarters": Change(steps=3, parts=4),
    "flip and half": Change(True, 2, 4),
}
OFF = {
    "erase_probability": 0.0,
    "erase_fraction": (0.02, 0.2),
    "erase_aspect": (0.5, 2.0),
    "brightness": 0.0,
    "contrast": 0.0,
    "saturation": 0.0,
    "hue_deg": 0.0,
    "flip_probability": 0.0,
    "yaw_probability": 0.0,
    "drop_past_probability": 0.0,
}


def pose(x_m, y_m, z_m, yaw_rad):
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:2, :2] = torch.tensor([[math.cos(yaw_rad), -math.sin(yaw_rad)], [math.sin(yaw_rad), math.cos(yaw_rad)]])
    matrix[:3, 3] = torch.tensor([x_m, y_m, z_m])
    return matrix


def rigs():
    rig = Rig.load("fisheye6").resized(WIDTH, HEIGHT)
    masks = tuple(torch.rand(HEIGHT, WIDTH) > 0.1 for _ in range(6))
    return rig, Rig(rig.cameras, rig.ego_from_camera, rig.names, masks), Rig.load("pinhole6").resized(WIDTH, HEIGHT)


@pytest.fixture(params=list(GRIDS))
def grid(request):
    return GRIDS[request.param]


@pytest.fixture
def batch(grid):
    torch.manual_seed(0)
    size = 3
    return Batch(
        images=torch.randint(0, 256, (size, WINDOW, 6, 3, HEIGHT, WIDTH), dtype=torch.uint8),
        rigs=tuple((rig,) * WINDOW for rig in rigs()),
        world_from_ego=torch.stack([pose(30 + 2 * t, 5.0 + t, 0.1 * t, 0.5 + 0.2 * t) for t in range(WINDOW)])
        .expand(size, -1, -1, -1)
        .clone(),
        voxels=torch.randint(0, 12, (size, *grid.shape), dtype=torch.uint8),
        pixel_labels=torch.randint(0, 12, (size, 6, HEIGHT, WIDTH), dtype=torch.uint8),
        lidar_range_m=torch.rand(size, 50) * 50,
        lidar_labels=torch.randint(0, 12, (size, 50), dtype=torch.uint8),
        lidar_directions=torch.nn.functional.normalize(torch.randn(size, 50, 3), dim=-1),
        lidar_origins=torch.randn(size, 50, 3),
        scan_origins=torch.randn(size, 40, 3),
        scan_ends=10 * torch.randn(size, 40, 3),
        scan_labels=torch.randint(0, 12, (size, 40), dtype=torch.uint8),
        frame_ids=("a/000007", "b/000003", "c/000002"),
        erp_range_m=torch.rand(size, 6, 24) * 30,
        camera_range_m=torch.rand(size, 6, HEIGHT, WIDTH) * 30,
        depth_range_m=torch.rand(size, 6, 24) * 30,
        candidates=torch.rand(size, WINDOW, *grid.shape) < 0.5,
        evidence=torch.rand(size, WINDOW, 2, *grid.shape),
        exists=torch.tensor([[True] * 3, [False, True, True], [True] * 3]),
    )


def same(batch, other):
    for name, mine, theirs in zip(Batch._fields, batch, other, strict=True):
        if isinstance(mine, torch.Tensor):
            assert mine.dtype == theirs.dtype, name
            torch.testing.assert_close(mine, theirs, rtol=0, atol=4e-6 if name.startswith(("lidar", "scan")) else 0.0)
        else:
            assert mine == theirs, name


def new_from_old(change):
    matrix = torch.diag(torch.tensor([1.0, -1.0 if change.flip else 1.0, 1.0], dtype=torch.float64))
    angle = 2 * math.pi * change.steps / change.parts
    turn = [[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    return torch.tensor(turn, dtype=torch.float64) @ matrix


@pytest.mark.parametrize("name", list(CHANGES))
def test_every_pixel_still_sees_the_voxel_it_saw(grid, batch, name):
    change = CHANGES[name]
    changed = change_scenes(batch, grid, [change] * 3)
    centers_m = grid.centers(torch.float64).reshape(-1, 3)
    moved, inside = grid.flat_index(centers_m @ new_from_old(change).T)
    assert inside.all()
    for sample in range(3):
        assert torch.equal(changed.voxels[sample].flatten()[moved], batch.voxels[sample].flatten())
        assert torch.equal(changed.candidates[sample].flatten(1)[:, moved], batch.candidates[sample].flatten(1))
        pixels, valid = batch.newest_rigs[sample].project(centers_m)
        new_pixels, new_valid = changed.newest_rigs[sample].project(centers_m[moved])
        clear = ((pixels - pixels.floor() - 0.5).abs() > 1e-6).all(-1)  # else rounding decides
        assert torch.equal(valid & clear, new_valid & clear)
        assert (valid & clear).sum() > 100
        for camera in range(6):
            seen = (valid & clear)[camera]
            u, v = pixels[camera, seen].round().long().unbind(-1)
            new_u, new_v = new_pixels[camera, seen].round().long().unbind(-1)
            for old, new in (
                (batch.images[sample, :, camera], changed.images[sample, :, camera]),
                (batch.pixel_labels[sample, camera], changed.pixel_labels[sample, camera]),
                (batch.camera_range_m[sample, camera], changed.camera_range_m[sample, camera]),
            ):
                assert torch.equal(old[..., v, u], new[..., new_v, new_u])


@pytest.mark.parametrize("name", list(CHANGES))
def test_rays_of_lidar_and_panorama_keep_what_they_hit(grid, batch, name):
    change = CHANGES[name]
    changed = change_scenes(batch, grid, [change] * 3)
    spots, new_spots = (
        part.lidar_origins + part.lidar_directions * part.lidar_range_m[..., None] for part in (batch, changed)
    )
    torch.testing.assert_close(new_spots.double(), spots.double() @ new_from_old(change).T, rtol=0, atol=2e-5)
    for old, new in ((batch.scan_origins, changed.scan_origins), (batch.scan_ends, changed.scan_ends)):
        torch.testing.assert_close(new.double(), old.double() @ new_from_old(change).T, rtol=0, atol=2e-5)
    assert torch.equal(changed.scan_labels, batch.scan_labels)
    assert torch.equal(changed.lidar_labels, batch.lidar_labels)
    azimuth = math.pi - (torch.arange(24, dtype=torch.float64) + 0.5) * 2 * math.pi / 24
    ahead = torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros(24)], dim=-1)
    for old, new in ((batch.erp_range_m, changed.erp_range_m), (batch.depth_range_m, changed.depth_range_m)):
        for row in range(6):
            spots = [old[1, row, :, None] * ahead @ new_from_old(change).T, new[1, row, :, None] * ahead]
            ranked = [part[part.norm(dim=-1).argsort()] for part in spots]
            torch.testing.assert_close(*ranked, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", list(CHANGES))
def test_motion_changes_along(grid, batch, name):
    change = CHANGES[name]
    rotation = change_poses(batch.world_from_ego, change)[..., :3, :3]
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3).double().expand_as(rotation))
    assert (torch.linalg.det(rotation) > 0.99).all()
    volumes = torch.rand(WINDOW, 3, 2, *grid.shape, dtype=torch.float64)
    fuse = Mean(grid, WINDOW, False)
    fused = fuse(list(volumes), batch.world_from_ego, batch.exists)
    as_cells = [batch._replace(voxels=volume) for volume in (*volumes, fused)]
    *moved, expected = (change_scenes(part, grid, [change] * 3).voxels for part in as_cells)
    poses = change_scenes(batch, grid, [change] * 3).world_from_ego
    torch.testing.assert_close(fuse(list(moved), poses, batch.exists), expected, rtol=0, atol=1e-9)


def test_two_flips_are_none(grid, batch):
    flip = [Change(flip=True)] * 3
    once = change_scenes(batch, grid, flip)
    assert not torch.equal(once.images, batch.images)
    assert once.rigs[0] != batch.rigs[0]
    same(change_scenes(once, grid, flip), batch)


def test_four_quarter_turns_are_none(grid, batch):
    quarter = [Change(steps=1, parts=4)] * 3
    turned = batch
    for _ in range(4):
        turned = change_scenes(turned, grid, quarter)
    torch.testing.assert_close(turned.world_from_ego, batch.world_from_ego, rtol=0, atol=1e-12)
    for rig, was in zip(turned.newest_rigs, batch.newest_rigs, strict=True):
        torch.testing.assert_close(rig.ego_from_camera, was.ego_from_camera, rtol=0, atol=1e-12)
    same(turned._replace(world_from_ego=batch.world_from_ego, rigs=batch.rigs), batch)


def test_samples_change_on_their_own(batch, grid):
    mixed = change_scenes(batch, grid, [Change(), Change(flip=True), Change(steps=1, parts=4)])
    assert torch.equal(mixed.images[0], batch.images[0])
    assert mixed.rigs[0] == batch.rigs[0] != mixed.rigs[1]
    assert torch.equal(mixed.images[1], batch.images[1].flip(-1))
    assert torch.equal(mixed.images[2], batch.images[2])
    assert torch.equal(mixed.exists, batch.exists)


def test_turns_take_cells_to_cells_and_columns_to_columns(batch, grid):
    bare = batch._replace(erp_range_m=None, depth_range_m=None)
    expected = {GRIDS["cylinder"]: (4, 20), GRIDS["ring"]: (12, 12), GRIDS["cuboid"]: (4, 4)}[grid]
    assert (count_turns(batch, grid), count_turns(bare, grid)) == expected
    assert count_turns(bare, Cuboid((8, 6, 4))) == 1
    for step in range(1, expected[1]):
        changed = change_scenes(bare, grid, [Change(steps=step, parts=expected[1])] * 3)
        assert sorted(changed.evidence[0].flatten().tolist()) == sorted(bare.evidence[0].flatten().tolist())


def test_a_grid_that_is_not_the_same_on_both_sides_is_refused(batch):
    lopsided = Cuboid((8, 8, 4), y_m=(-20.0, 25.6))
    part = batch._replace(voxels=torch.zeros(3, 8, 8, 4, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"symmetric.*Change"):
        change_scenes(part, lopsided, [Change(flip=True)] * 3)


def augment(grid, **on):
    return Augment(grid, **{**OFF, **on})


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def test_all_off_changes_nothing(grid, batch):
    same(augment(grid)(batch, seeded()), batch)


def test_draws_follow_the_seed(grid, batch):
    options = {
        "erase_probability": 0.5,
        "brightness": 0.2,
        "contrast": 0.2,
        "saturation": 0.2,
        "hue_deg": 20.0,
        "flip_probability": 0.5,
        "yaw_probability": 0.5,
        "drop_past_probability": 0.5,
    }
    changed = augment(grid, **options)
    same(changed(batch, seeded(3)), changed(batch, seeded(3)))
    assert not torch.equal(changed(batch, seeded(3)).images, changed(batch, seeded(4)).images)


def test_flips_and_turns_have_their_probabilities(batch, grid):
    rigs = itertools.chain.from_iterable(
        augment(grid, flip_probability=0.3, yaw_probability=1.0)(batch, seeded(seed)).newest_rigs[:1]
        for seed in range(200)
    )
    drawn = [(type(rig.cameras[0]).__name__, rig) for rig in rigs]
    fraction = sum(name == "Mirrored" for name, _ in drawn) / 200
    assert fraction == pytest.approx(0.3, abs=0.1)
    assert len({rig for _, rig in drawn}) == 2 * count_turns(batch, grid)


def test_dropped_frames_are_past_ones_that_existed(batch, grid):
    change = augment(grid, drop_past_probability=0.25)
    drawn = torch.stack([change(batch, seeded(seed)).exists for seed in range(300)]).double().mean(0)
    expected = torch.tensor([[0.75, 0.75, 1.0], [0.0, 0.75, 1.0], [0.75, 0.75, 1.0]], dtype=torch.float64)
    torch.testing.assert_close(drawn, expected, rtol=0, atol=0.1)
    assert torch.equal((drawn == 1) | (drawn == 0), (expected == 1) | (expected == 0))


def test_erased_boxes_have_one_colour_and_the_wanted_size():
    images = torch.full((50, 2, 6, 3, 40, 60), 7, dtype=torch.uint8)
    images[..., ::2] = 9
    erased, mask = erase(images, 0.4, (0.1, 0.3), (0.5, 2.0), seeded())
    assert torch.equal(images[..., 1], torch.full_like(images[..., 1], 7))  # the input stays as it was
    changed = (erased != images).any(-3).flatten(0, 2)
    assert torch.equal(mask, (erased != images).any(-3))
    hit = changed.flatten(1).any(1)
    assert hit.double().mean() == pytest.approx(0.4, abs=0.06)
    for image, box in zip(erased.flatten(0, 2)[hit], changed[hit], strict=True):
        rows, columns = box.any(1).nonzero()[:, 0], box.any(0).nonzero()[:, 0]
        area = image[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        assert (area == area[:, :1, :1]).all()
        assert 0.08 < area[0].numel() / 2400 < 0.33
        assert 0.4 < area.shape[2] / area.shape[1] < 2.5


def test_erased_pixels_of_the_newest_frame_lose_their_labels_and_no_others_do(batch, grid):
    changed = augment(grid, erase_probability=1.0)(batch, seeded())
    differ = (changed.images[:, -1] != batch.images[:, -1]).any(-3)
    lost = changed.pixel_labels == 255
    assert (differ & ~lost).sum() == 0
    assert lost.flatten(2).any(-1).all()
    assert torch.equal(changed.pixel_labels[~lost], batch.pixel_labels[~lost])
    assert lost.double().mean() < 0.25
    assert torch.equal(changed.voxels, batch.voxels)


def test_every_image_loses_a_box_at_probability_one():
    images = torch.randint(0, 256, (4, 1, 6, 3, 30, 40), dtype=torch.uint8)
    erased, _ = erase(images, 1.0, (0.05, 0.05), (1.0, 1.0), seeded())
    assert (erased != images).flatten(3).any(-1).all()


def test_colors_change_per_camera_and_stay_within_a_window():
    frame = torch.randint(60, 180, (2, 1, 6, 3, 20, 30), dtype=torch.uint8)
    images = frame.expand(-1, 3, -1, -1, -1, -1)
    changed = jitter(images, 0.3, 0.3, 0.3, 15.0, seeded())
    assert changed.dtype == torch.uint8
    assert changed.shape == images.shape
    assert torch.equal(changed[:, 0], changed[:, 2])
    means = changed[:, 0].float().mean((-2, -1))
    assert len({tuple(row) for row in means.flatten(0, 1).tolist()}) == 12


def test_each_color_change_does_what_it_says():
    images = torch.randint(60, 140, (1, 1, 8, 3, 20, 30), dtype=torch.uint8)
    luminance = torch.tensor([0.299, 0.587, 0.114])

    def grey(pixels):
        return torch.einsum("c,...chw->...hw", luminance, pixels.float())

    bright = jitter(images, 0.3, 0.0, 0.0, 0.0, seeded())
    factors = (bright.float() / images).flatten(3).mean(-1)
    torch.testing.assert_close(bright.float(), images * factors[..., None, None, None], rtol=0, atol=1.0)
    assert factors.std() > 0.05
    steep = jitter(images, 0.0, 0.3, 0.0, 0.0, seeded())
    torch.testing.assert_close(grey(steep).mean((-2, -1)), grey(images).mean((-2, -1)), rtol=0, atol=0.3)
    assert (grey(steep).std((-2, -1)) / grey(images).std((-2, -1)) - 1).abs().max() > 0.1
    for vivid in (jitter(images, 0.0, 0.0, 0.5, 0.0, seeded()), jitter(images, 0.0, 0.0, 0.0, 30.0, seeded())):
        assert (vivid != images).any()
        torch.testing.assert_close(grey(vivid), grey(images), rtol=0, atol=1.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"erase_probability": 1.2}, r"erase_probability is 1\.2"),
        ({"brightness": -0.1}, r"brightness is -0\.1"),
        ({"erase_fraction": (0.3, 0.2)}, r"erase_fraction is \[0\.3, 0\.2\]"),
        ({"erase_aspect": (0.0, 2.0)}, r"erase_aspect is \[0\.0, 2\.0\]"),
    ],
)
def test_values_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        augment(GRIDS["cuboid"], **wrong)
