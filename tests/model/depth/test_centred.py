"""Ranges around the cameras' height, re-projected, are those of a rig whose origin lies there."""

import torch

from omniocc.model.ops.depth.z_buffer import reproject


def test_the_network_sees_the_rig_at_the_height_of_its_cameras(small, rig):
    torch.manual_seed(0)
    images = torch.rand(1, len(rig.cameras), 3, 36, 64)
    torch.manual_seed(0)
    plain = small("OmniMVS").eval()
    model = small("Centred").eval()
    model.load_state_dict(plain.state_dict())
    mean_m = float(rig.ego_from_camera[:, 2, 3].mean())
    level = rig.raised(mean_m)
    with torch.no_grad():
        low, high = plain(images, (level,)), model(images, (level.raised(1.4),))
        expected = reproject(low, plain.panorama, plain.rig_spheres(level.raised(1.4)), -1.4)
        direct = plain(images, (level.raised(1.4),))
    for ours, theirs in zip(high, expected, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-3)
    assert not torch.allclose(high.range_m, direct.range_m, rtol=0.05)
