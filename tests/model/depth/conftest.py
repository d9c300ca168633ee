import pytest
import torch

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
