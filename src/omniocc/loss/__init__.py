"""Losses: one class per file; `Total` names and weighs them."""

from omniocc.loss.cross_entropy import CrossEntropy
from omniocc.loss.dice import Dice
from omniocc.loss.first_hit import FirstHit
from omniocc.loss.frustums import Frustums
from omniocc.loss.lovasz import Lovasz
from omniocc.loss.range_bins import RangeBins
from omniocc.loss.run_lengths import RunLengths
from omniocc.loss.scal import Scal
from omniocc.loss.semantics import Semantics
from omniocc.loss.silog import SILog
from omniocc.loss.total import Total

__all__ = [
    "CrossEntropy",
    "Dice",
    "FirstHit",
    "Frustums",
    "Lovasz",
    "RangeBins",
    "RunLengths",
    "SILog",
    "Scal",
    "Semantics",
    "Total",
]
