import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.model import depth

LOSS = {"log_range_weight": 2.0, "entropy_weight": 0.5, "sky_weight": 0.5}
SIZES = {
    "Truth": {},
    "Sweep": {"window_px": 5, "min_confidence": 0.0},
    "Mono": {"channels": [8, 8], "focus": 0.85, "sky_weight": 0.2, "mirror": True},
    "OmniMVS": {
        "loss": depth.SphereLoss(**LOSS),
        "feature_channels": [8, 8],
        "feature_stride": 2,
        "match_channels": 4,
        "groups": 2,
        "context_channels": 4,
        "sweep_stride": 1,
        "channels": [8, 8],
        "fine_channels": 8,
        "blocks": 1,
        "window": 2,
        "min_confidence": 0.0,
        "mirror": False,
    },
    "OmniMVS3D": {
        "loss": depth.SphereLoss(**LOSS),
        "feature_channels": [8, 8],
        "match_channels": 4,
        "sweep_stride": 2,
        "channels": [8, 8],
        "window": 2,
        "min_confidence": 0.0,
        "mirror": False,
    },
}


@pytest.fixture
def small():
    """Build an option at a small size, always with the same weights."""

    def build(name: str, width=48, height=12, spheres=8, min_range_m=1.6, **changes):
        torch.manual_seed(0)
        panorama = Equirectangular(width, height, 45.0, -45.0)
        parts = {"panorama": panorama, "spheres": depth.SphereRange(spheres, min_range_m)}
        return getattr(depth, name)(**(parts | SIZES[name] | changes))

    return build
