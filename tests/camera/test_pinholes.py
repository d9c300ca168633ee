import math

import pytest
import torch

from omniocc.camera import MEI, Equirectangular, KannalaBrandt, Pinhole, Rig
from omniocc.camera.models.mirrored import Mirrored
from omniocc.camera.pinholes import as_pinholes, pinhole_of

FISHEYE = Rig.load("fisheye6").resized(64, 36)
MODELS = [
    FISHEYE.cameras[0],
    KannalaBrandt(64, 36, (19.0, 21.0), (30.5, 18.0), (0.02, -0.01, 0.003, 0.0), 95.0),
    MEI(64, 36, (40.0, 42.0), (31.0, 17.5), 1.2, (-0.1, 0.02, 0.001, -0.001), 95.0),
    Mirrored(FISHEYE.cameras[0]),
]


@pytest.mark.parametrize("camera", MODELS, ids=lambda camera: type(camera).__name__)
def test_it_agrees_with_the_lens_near_the_axis_and_with_perspective_everywhere(camera):
    flat = pinhole_of(camera)
    assert (flat.width, flat.height) == (camera.width, camera.height)
    near = torch.tensor([[0.0, 0.0, 1.0], [1e-3, 2e-3, 1.0], [-2e-3, 1e-3, 1.0]], dtype=torch.float64)
    torch.testing.assert_close(flat.project(near)[0], camera.project(near)[0], rtol=0, atol=1e-3)
    # on a line through the axis, distances grow with the tangent of the angle
    slopes = torch.tensor([0.1, 0.2, 0.4], dtype=torch.float64)
    points = torch.stack([slopes, 0 * slopes, torch.ones(3, dtype=torch.float64)], dim=-1)
    shift = flat.project(points)[0] - flat.project(near[:1])[0]
    torch.testing.assert_close(shift[:, 0] / shift[0, 0], slopes / slopes[0])


def test_a_pinhole_camera_stays_what_it_is():
    camera = Pinhole(64, 36, (30.0, 31.0), (31.2, 17.9))
    flat = pinhole_of(camera)
    assert isinstance(flat, Pinhole)
    assert flat.focal_px == pytest.approx(camera.focal_px, rel=1e-9)
    assert flat.center_px == pytest.approx(camera.center_px)


def test_a_rig_keeps_poses_and_masks_and_loses_what_is_behind():
    flat = as_pinholes(FISHEYE)
    assert torch.equal(flat.ego_from_camera, FISHEYE.ego_from_camera)
    assert flat.masks is FISHEYE.masks
    assert flat != FISHEYE
    for camera, own in zip(flat.cameras, FISHEYE.cameras, strict=True):
        assert camera.focal_px == pytest.approx((own.focal_px,) * 2, rel=1e-6)
        angle = math.radians(92)
        behind = torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]], dtype=torch.float64)
        assert own.project(behind)[1].all()
        assert not camera.project(behind)[1].any()


def test_a_panorama_has_no_axis_and_is_named():
    rig = Rig((Equirectangular(64, 16, 45.0, -45.0),), torch.eye(4, dtype=torch.float64)[None], ("ring",))
    with pytest.raises(ValueError, match=r"camera 'ring'.*optical axis"):
        as_pinholes(rig)
