import math

import pytest
import torch

from omniocc.camera import Rig
from omniocc.camera.ground import pose_from_ground
from omniocc.camera.pose import pose_from_angles

RIG = Rig.load("surround_view")


def cloth(rows):
    table = torch.tensor(rows, dtype=torch.float64)
    ground = torch.cat([table[:, :2], torch.zeros(len(table), 1, dtype=torch.float64)], dim=1)
    return ground, table[:, 2:]


@pytest.mark.parametrize("name", ["front", "right", "back", "left"])
def test_poses_of_real_cameras_are_recovered_from_the_cloth(name, corners):
    ground, pixels = cloth(corners["cameras"][name])
    index = RIG.names.index(name)
    pose, errors_px = pose_from_ground(RIG.cameras[index], pixels, ground)
    assert errors_px.square().mean().sqrt() < 0.8
    assert errors_px.max() < 1.8
    origin = torch.tensor(corners["origin_m"], dtype=torch.float64)
    torch.testing.assert_close(pose[:3, 3] - origin, RIG.ego_from_camera[index, :3, 3], rtol=0, atol=2e-3)
    torch.testing.assert_close(pose[:3, :3], RIG.ego_from_camera[index, :3, :3], rtol=0, atol=2e-3)


def test_built_in_rig_projects_the_cloth_to_its_pixels(corners):
    origin = torch.tensor(corners["origin_m"], dtype=torch.float64)
    for index, name in enumerate(RIG.names):
        ground, pixels = cloth(corners["cameras"][name])
        projected, valid = RIG.project(ground - origin)
        assert valid[index].all()
        assert (projected[index] - pixels).norm(dim=-1).median() < 0.8


def test_rays_of_two_cameras_intersect_at_one_point_of_the_cloth(corners):
    """Intersect the rays of two cameras to the same corner, without using the ground."""
    by_place = {name: {tuple(row[:2]): row[2:] for row in rows} for name, rows in corners["cameras"].items()}
    distances = []
    for first, second in (("front", "left"), ("front", "right"), ("back", "left"), ("back", "right")):
        for place in by_place[first].keys() & by_place[second].keys():
            lines = []
            for name in (first, second):
                index = RIG.names.index(name)
                pixel = torch.tensor(by_place[name][place], dtype=torch.float64)
                pose = RIG.ego_from_camera[index]
                lines.append((pose[:3, 3], pose[:3, :3] @ RIG.cameras[index].unproject(pixel)[0]))
            (a, p), (b, q) = lines
            normal = torch.linalg.cross(p, q)
            distances.append(float((b - a) @ normal / normal.norm()))
    assert len(distances) >= 10
    assert torch.tensor(distances).abs().median() < 0.02, "metres between the two rays"


@pytest.mark.parametrize("name", ["kitti360_image_03", "omnimvs_sunny_single_cam1 exact", "basalt_test_ds"])
def test_every_model_and_points_past_90_degrees(name, known, build_camera):
    name, _, exact = name.partition(" ")
    camera = build_camera(known["cameras"][name], exact=bool(exact))
    truth = pose_from_angles((0.3, -0.2, 1.1), 30.0, -35.0, 4.0)
    x, y = torch.meshgrid(torch.linspace(-2, 6, 17), torch.linspace(-4, 4, 17), indexing="ij")
    ground = torch.stack([x, y, torch.zeros_like(x)], -1).view(-1, 3).double()
    in_camera = (ground - truth[:3, 3]) @ truth[:3, :3]
    pixels, valid = camera.project(in_camera)
    assert (in_camera[valid, 2] < 0).any(), "the test needs points past 90 degrees"
    pose, errors_px = pose_from_ground(camera, pixels[valid], ground[valid])
    torch.testing.assert_close(pose, truth, rtol=0, atol=1e-8)
    assert errors_px.max() < 1e-5


def test_error_names_unusable_points(corners):
    ground, pixels = cloth(corners["cameras"]["front"])
    camera = RIG.cameras[0]
    with pytest.raises(ValueError, match=r"3 points.* 4"):
        pose_from_ground(camera, pixels[:3], ground[:3])
    line = ground.clone()
    line[:, 1] = 2 * line[:, 0]
    with pytest.raises(ValueError, match="on one line"):
        pose_from_ground(camera, pixels, line)
    bumpy = ground.clone()
    bumpy[3, 2] = 0.2
    with pytest.raises(ValueError, match="one plane"):
        pose_from_ground(camera, pixels, bumpy)
    outside = pixels.clone()
    outside[0] = torch.tensor([5.0, 5.0])
    with pytest.raises(ValueError, match=r"pixels.*\[\[5.0, 5.0\]\]"):
        pose_from_ground(camera, outside, ground)


def test_angles_of_the_real_car_are_plausible():
    yaws_deg = {"front": 0, "right": -90, "back": 180, "left": 90}
    for name, yaw_deg in yaws_deg.items():
        forward = RIG.ego_from_camera[RIG.names.index(name), :3, 2]
        found_deg = math.degrees(math.atan2(forward[1], forward[0]))
        assert abs((found_deg - yaw_deg + 180) % 360 - 180) < 6
        assert forward[2] < 0
