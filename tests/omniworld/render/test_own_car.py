from dataclasses import replace

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.errors import UserError
from omniworld import Scene
from omniworld.assets.vehicle import ego_car
from omniworld.render.own_car import car_under, grown, mask_ego_car, masking, own_car_pixels, read_obj, show_ego_car

RIG = Rig.load("fisheye6").resized(64, 36)
BARE = replace(RIG, masks=None)


@pytest.fixture(scope="module")
def frame():
    return Scene("suburb", 3, RIG, supersample=1, erp_size=(48, 12), lidars=1).frame(0)


def test_masked_pixels_are_those_that_the_renderer_draws_the_car_in(frame):
    masked = mask_ego_car(BARE)
    for camera, labels in enumerate(frame.semantics):
        lens, usable = BARE.rays(camera)[1].numpy(), masked.rays(camera)[1].numpy()
        assert np.array_equal(lens & ~usable, lens & (labels == UNKNOWN))
        assert (lens & ~usable).any()


def test_masks_of_a_rig_do_not_blacken_the_car(frame):
    unmasked = Scene("suburb", 3, BARE, supersample=1, erp_size=(48, 12), lidars=1).frame(0)
    assert np.array_equal(frame.images, unmasked.images)


def test_other_masks_stay_black():
    mask = torch.ones(36, 64, dtype=torch.bool)
    mask[:10] = False
    shown = show_ego_car(replace(BARE, masks=(mask, *[None] * 5)))
    assert shown.masks is not None
    assert shown.masks[1] is None
    assert torch.equal(shown.masks[0][:10], mask[:10])


def test_built_in_rigs_leave_out_the_car_of_the_virtual_world():
    for name in ("fisheye6", "pinhole6"):
        rig = Rig.load(name)
        expected = masking(replace(rig, masks=None), grown(own_car_pixels(rig, ego_car()), 1))
        assert rig == expected


def test_no_voxel_is_seen_through_the_own_car():
    rig = mask_ego_car(BARE)
    assert rig.masks is not None
    points = torch.rand(20_000, 3, dtype=torch.float64) * torch.tensor([12.0, 12.0, 2.4]) - torch.tensor([6, 6, 2.2])
    pixels, valid = rig.project(points)
    car = own_car_pixels(BARE, ego_car())
    lost = BARE.project(points)[1] & ~valid
    assert lost.any()
    for camera in range(6):
        column, row = pixels[camera][valid[camera]].round().long().unbind(-1)
        assert not car[camera][row, column].any()


def test_growing_adds_neighbours():
    pixels = torch.zeros(5, 6, dtype=torch.bool)
    pixels[2, 3] = True
    assert int(grown((pixels,), 1)[0].sum()) == 9
    assert int(grown((pixels,), 0)[0].sum()) == 1


def test_obj_files_of_triangles_and_polygons(tmp_path):
    path = tmp_path / "box.obj"
    path.write_text("# a square below the cameras\nv -3 -3 -1\nv 3 -3 -1 0.5\nv 3 3 -1\nv -3 3 -1\nf 1/1/1 2//1 3 -1\n")
    mesh = read_obj(path)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.vertices[2].tolist() == [3, 3, -1]
    assert any(part.any() for part in own_car_pixels(BARE, mesh))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 zero\n", "line 1: 'v 0 0 zero' is not a corner or face"),
        ("v 0 0 0\nf 1 2 3\n", "line 2.*there is no corner 2 yet"),
        ("v 0 0 0\n", "has no faces"),
    ],
)
def test_damaged_obj_files_are_named(tmp_path, text, message):
    (tmp_path / "car.obj").write_text(text)
    with pytest.raises(UserError, match=message):
        read_obj(tmp_path / "car.obj")
    with pytest.raises(UserError, match=r"none\.obj cannot be read"):
        read_obj(tmp_path / "none.obj")


def test_the_car_stands_on_the_road_of_the_rig_and_is_left_out_around_cameras():
    high = replace(BARE, road_z_m=-2.5)
    assert car_under(high).vertices[:, 2].min() == pytest.approx(-2.5, abs=0.01)
    assert np.array_equal(car_under(BARE).vertices, ego_car().vertices)
    assert len(car_under(replace(BARE, road_z_m=-0.9)).faces) == 0  # its cameras would be in the seats


def test_a_lower_origin_moves_the_world_up(frame):
    low = Scene("suburb", 3, replace(BARE, road_z_m=-1.0), supersample=1, erp_size=(48, 12), lidars=1).frame(0)
    assert frame.world_from_ego[2, 3] - low.world_from_ego[2, 3] == pytest.approx(1.2, abs=0.02)
    below = [np.median(one.points_m[one.point_labels == 1][:, 2]) for one in (frame, low)]  # of the road
    assert below == pytest.approx([-2.2, -1.0], abs=0.25)
    assert not (low.semantics == UNKNOWN).sum() > (frame.semantics == UNKNOWN).sum()
