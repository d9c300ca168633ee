"""Parts in the style of other systems: AdaptiveOcc, FlashOcc, FoSOcc, MonoScene and OneOcc."""

from omniocc.extras.rivals.bi_grid import BiGrid
from omniocc.extras.rivals.channel_to_height import ChannelToHeight
from omniocc.extras.rivals.coarse_to_fine import CoarseToFine
from omniocc.extras.rivals.experts import Experts
from omniocc.extras.rivals.focus import Focus
from omniocc.extras.rivals.frustums import Frustums
from omniocc.extras.rivals.run_lengths import RunLengths
from omniocc.extras.rivals.splat_coloring import SplatColoring

__all__ = [
    "BiGrid",
    "ChannelToHeight",
    "CoarseToFine",
    "Experts",
    "Focus",
    "Frustums",
    "RunLengths",
    "SplatColoring",
]
