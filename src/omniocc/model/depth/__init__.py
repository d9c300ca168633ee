"""Depth slot: the range around the ego origin, seen from several cameras."""

from omniocc.model.depth.mono import Mono
from omniocc.model.depth.omnimvs import OmniMVS
from omniocc.model.depth.omnimvs3d import OmniMVS3D
from omniocc.model.depth.sweep import Sweep
from omniocc.model.depth.truth import Truth
from omniocc.model.ops.depth.depth_map import DepthMap
from omniocc.model.ops.depth.sphere_net import SphereLoss
from omniocc.model.ops.depth.spheres import SphereRange, Spheres
from omniocc.model.protocols import Depth, LearnedDepth, learns

__all__ = [
    "Depth",
    "DepthMap",
    "LearnedDepth",
    "Mono",
    "OmniMVS",
    "OmniMVS3D",
    "SphereLoss",
    "SphereRange",
    "Spheres",
    "Sweep",
    "Truth",
    "learns",
]
