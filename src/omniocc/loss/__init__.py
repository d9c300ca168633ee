"""Losses: one class per file; `TotalLoss` names and weighs them."""

from omniocc.loss.cross_entropy import CrossEntropy
from omniocc.loss.dice import Dice
from omniocc.loss.first_hit import FirstHit
from omniocc.loss.lidar_rays import LidarRays, Rays, RayWindow
from omniocc.loss.lovasz import Lovasz
from omniocc.loss.range_bins import RangeBins
from omniocc.loss.scal import SceneClassAffinity
from omniocc.loss.semantics import Semantics
from omniocc.loss.silog import SILog
from omniocc.loss.total import RayLoss, TotalLoss

__all__ = [
    "CrossEntropy",
    "Dice",
    "FirstHit",
    "LidarRays",
    "Lovasz",
    "RangeBins",
    "RayLoss",
    "RayWindow",
    "Rays",
    "SILog",
    "SceneClassAffinity",
    "Semantics",
    "TotalLoss",
]
