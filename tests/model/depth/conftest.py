import math

import pytest
import torch

from omniocc.camera import Equidistant, Rig
from omniocc.camera.pose import pose_from_angles


def ring(count: int, width: int = 64, height: int = 36, radius_m: float = 0.9, masks=None) -> Rig:
    """Fisheyes of 190 degrees on a circle, looking outwards."""
    focal_px = width / 2 / math.radians(95)
    camera = Equidistant(width, height, focal_px, ((width - 1) / 2, (height - 1) / 2), 95.0)
    yaws = [-360 / count * k for k in range(count)]
    poses = [
        pose_from_angles(
            (radius_m * math.cos(math.radians(yaw)), radius_m * math.sin(math.radians(yaw)), 0.0), yaw, -10.0, 0.0
        )
        for yaw in yaws
    ]
    return Rig((camera,) * count, torch.stack(poses), tuple(f"camera{k}" for k in range(count)), masks)


@pytest.fixture(scope="session")
def rig() -> Rig:
    return ring(6)


@pytest.fixture(scope="session")
def make_ring():
    return ring


VIEW = {"erp_size": [48, 12], "erp_top_deg": 45.0, "erp_bottom_deg": -45.0, "min_range_m": 1.6}
SIZES = {
    "Truth": {},
    "Sweep": {"window_px": 5, "min_confidence": 0.0},
    "Mono": {"channels": [8, 8], "focus": 0.85, "sky_weight": 0.2, "mirror": True},
    "OmniMVS": {
        "feature_channels": [8, 8],
        "match_channels": 4,
        "groups": 2,
        "context_channels": 4,
        "sweep_stride": 1,
        "channels": [8, 8],
        "fine_channels": 8,
        "blocks": 1,
        "window": 2,
        "min_confidence": 0.0,
        "log_range_weight": 2.0,
        "entropy_weight": 0.5,
        "sky_weight": 0.5,
        "mirror": False,
    },
    "OmniMVS3D": {
        "feature_channels": [8, 8],
        "match_channels": 4,
        "sweep_stride": 2,
        "channels": [8, 8],
        "window": 2,
        "min_confidence": 0.0,
        "log_range_weight": 2.0,
        "entropy_weight": 0.5,
        "sky_weight": 0.5,
        "mirror": False,
    },
}


@pytest.fixture
def small():
    """Builds an option at a small size, always with the same weights."""
    from omniocc.model import depth

    def build(name: str, **changes):
        torch.manual_seed(0)
        return getattr(depth, name)(**({"spheres": 8} | VIEW | SIZES[name] | changes))

    return build
