import math
from dataclasses import replace

import pytest
import torch

from omniocc.camera import Equidistant, KannalaBrandt, Panoramic, Pinhole, Rig
from omniocc.camera.plausible import cross, field_of, kind_of, suspicious
from omniocc.camera.pose import LEVEL_FORWARD, pose_from_angles

WIDE = Equidistant(641, 481, 193.0, (320.0, 240.0), 95.0)
TURN = torch.eye(4, dtype=torch.float64)
TURN[:3, :3] = torch.tensor(LEVEL_FORWARD, dtype=torch.float64)


def ring(count=4, camera=WIDE, pitch=-10.0, roll=0.0, turned=0.0, radius=1.0, road_z_m=-0.9):
    """Return cameras around the origin that look outwards if `turned` is 0."""
    poses = []
    for yaw in (360 * k / count for k in range(count)):
        at_m = radius * math.cos(math.radians(yaw)), radius * math.sin(math.radians(yaw)), 0.0
        poses.append(pose_from_angles(at_m, yaw + turned, pitch, roll))
    names = tuple(f"camera{k}" for k in range(count))
    return Rig((camera,) * count, torch.stack(poses), names, None, road_z_m)


def posed(change):
    return replace(ring(), ego_from_camera=torch.stack([change(pose) for pose in ring().ego_from_camera]))


def lowered(camera, by_m):
    poses = ring().ego_from_camera
    poses[camera, 2, 3] -= by_m
    return replace(ring(), ego_from_camera=poses)


def inverted(pose):
    """Return the pose of which somebody wrote down the rotation from the ego frame to the camera's."""
    wrong = pose.clone()
    wrong[:3, :3] = pose[:3, :3].T
    return wrong


def test_fields_of_view_of_a_pinhole_are_those_of_its_tangents():
    field = field_of(Pinhole(640, 480, (320.0, 320.0), (319.5, 239.5)))
    assert field.horizontal_deg == pytest.approx(90.0, abs=1e-6)
    assert field.vertical_deg == pytest.approx(73.7398, abs=1e-4)
    assert field.px_per_deg == pytest.approx(7.1111, abs=1e-4)
    assert field.end_deg is None


def test_fields_of_view_beyond_half_a_turn():
    assert field_of(Equidistant(800, 800, 200.0, (399.5, 399.5), 95.0)).horizontal_deg == pytest.approx(190, abs=0.5)
    panorama = field_of(Panoramic(720, 90, 30.0, -60.0))
    assert panorama[:3] == pytest.approx((360.0, 90.0, 2.0), abs=1e-6)


def test_a_polynomial_that_turns_ends_the_view_inside_of_the_image():
    """The radius theta - 0.3 theta^3 rises up to theta = sqrt(1 / 0.9) = 60.4 degrees, which is 211 px here."""
    turning = KannalaBrandt(641, 481, (300.0, 300.0), (320.0, 240.0), (-0.3, 0.0, 0.0, 0.0), 95.0)
    assert 58 < field_of(turning).end_deg <= 60.4
    seen = cross(turning)[0][2]
    assert 2 * 209 < float(seen.double().mean()) * 641 < 2 * 212
    lines = suspicious(ring(camera=turning))
    assert len(lines) == 4
    assert "camera 'camera0': its lens model ends 5" in lines[0]
    assert suspicious(ring(camera=replace(turning, max_angle_deg=60.0))) == []


def test_nothing_is_suspicious_about_rigs_that_are_used():
    assert suspicious(Rig.load("surround_view")) == []
    assert suspicious(ring()) == suspicious(ring(2)) == suspicious(ring(8)) == []
    assert suspicious(replace(Rig.load("fisheye6"), road_z_m=-2.2)) == []


CASES = {
    "one camera: it is allowed": ring(1),
    "30 cameras: they are allowed": ring(30),
    "cameras are up to 2,000 m apart: are the positions in metres?": ring(radius=1000.0),
    "all cameras at the sky": ring(pitch=80.0),
    "all cameras at the ground": ring(pitch=-80.0),
    "camera 'camera0', 'camera2' sideways up or down, as they lie on their side: is ego_from_camera inverted?": posed(
        inverted
    ),
    "all cameras at the sky: is it the pose of a frame with x forward, z up?": replace(
        posed(lambda pose: pose @ torch.linalg.inv(TURN)), road_z_m=-2.0
    ),
    "all cameras sideways up or down, as they lie on their side": ring(roll=90.0),
    "all cameras look to the middle of the rig": ring(turned=180.0),
    "cameras look into each other: 'camera0' and 'camera1'": ring(2, turned=180.0),
    "the height of the road is not known": ring(road_z_m=None),
    "the road (road_z_m: -0.9) is above camera 'camera1'": lowered(1, 2.0),
    "the road (road_z_m: -90) is 90.0 m below the lowest camera: is it in metres?": ring(road_z_m=-90.0),
    "no two cameras see the same": ring(camera=Pinhole(640, 480, (400.0, 400.0), (319.5, 239.5))),
    "camera 'camera3': its optical axis is at (240, 320) px, far from the middle (320, 240)": ring(
        camera=replace(WIDE, center_px=(240.0, 320.0))
    ),
    "camera 'camera0': only 9% of its pixels have a ray": ring(camera=replace(WIDE, max_angle_deg=28.0)),
}


@pytest.mark.parametrize(("line", "rig"), CASES.items())
def test_what_is_wrong_is_named(line, rig):
    assert [found for found in suspicious(rig) if found.startswith(line)], suspicious(rig)


def test_a_camera_that_stands_twice_is_named():
    rig = ring()
    poses = rig.ego_from_camera.clone()
    poses[2] = poses[1]
    assert suspicious(replace(rig, ego_from_camera=poses)) == [
        "cameras 'camera1' and 'camera2' have the same pose: is one a copy of the other?"
    ]


def test_a_camera_that_looks_elsewhere_than_its_name_says_is_named():
    """Two cameras called left and right are a stereo pair unless another one is called front or rear."""
    rig = Rig.load("surround_view")
    poses = rig.ego_from_camera.clone()
    poses[0] = pose_from_angles((2.0, 0.0, 0.0), 90.0, -10.0, 0.0)
    wrong = replace(rig, ego_from_camera=poses)
    assert suspicious(wrong) == ["camera 'front' looks 90 degrees to the left of what its name says"]
    assert suspicious(replace(wrong, names=("a", "right", "c", "left"))) == []


NARROW = Pinhole(640, 480, (400.0, 400.0), (319.5, 239.5))


@pytest.mark.parametrize(
    ("rig", "kind"),
    [
        (ring(1), "one camera"),
        (ring(2), "wide cameras around"),
        (ring(5, NARROW), "narrow cameras around"),
        (posed(lambda pose: ring().ego_from_camera[0]), "wide cameras ahead"),
    ],
)
def test_the_kind_of_a_rig(rig, kind):
    assert kind_of(rig) == kind
