"""What a sketch hands on about every voxel: log-odds of being occupied, and what the panorama saw of it.

Eight bits hold both: six for the log-odds, two for the sight. Evidence that was stored and evidence that is computed
in a live sequence are the same numbers, since both go through these bits.
"""

from enum import IntEnum
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn import functional as F

LOG_ODDS = 0
"""Channel of the evidence with the log-odds of being occupied."""
CHANNELS = 4
"""Channels of the evidence: log-odds, and 1 where a voxel was hit, passed or hidden."""
INPUTS = CHANNELS + 1
"""Channels of `network_inputs`."""
LIMIT = 6.3
"""Largest log-odds that the bits hold; a probability of .998."""
STEPS = 63


class Sight(IntEnum):
    """What rays from the ego origin to the seen surfaces say about a voxel."""

    UNSEEN = 0
    HIT = 1
    PASSED = 2
    HIDDEN = 3


def pack_evidence(log_odds: Float[Tensor, "*B"], sight: UInt8[Tensor, "*B"]) -> UInt8[Tensor, "*B"]:
    """Return eight bits for every voxel, from its log-odds of being occupied (cut off at 6.3) and its `Sight`."""
    level = ((log_odds.float().clamp(-LIMIT, LIMIT) + LIMIT) * (STEPS / (2 * LIMIT))).round()
    return (level * len(Sight) + sight).to(torch.uint8)


def unpack_evidence(bits: UInt8[Tensor, "*B X Y Z"]) -> Float[Tensor, "*B 4 X Y Z"]:
    """Return log-odds of being occupied, and 1 or 0 for each of hit, passed and hidden."""
    return F.embedding(bits.int(), _unpacked(bits.device)).movedim(-1, -4).contiguous()


@lru_cache(maxsize=8)
def _unpacked(device: torch.device) -> Float[Tensor, "256 4"]:
    """Return the evidence of all values of the bits."""
    with torch.inference_mode(False):  # training may use it as well
        bits = torch.arange(256)
        level, sight = (bits // len(Sight)).float(), bits % len(Sight)
        seen = [(sight == value).float() for value in (Sight.HIT, Sight.PASSED, Sight.HIDDEN)]
        return torch.stack([level * (2 * LIMIT / STEPS) - LIMIT, *seen], dim=-1).to(device)


def sight_of(hit: Bool[Tensor, "*B"], known: Float[Tensor, "*B"], gap: Float[Tensor, "*B"]) -> UInt8[Tensor, "*B"]:
    """Return the `Sight` of voxels.

    Args:
        hit: whether a seen point lies in it.
        known: fraction of its directions in which a range is known.
        gap: mean of (range - distance) over its directions; positive in front of the seen surface.
    """
    passed = torch.where(gap > 0, int(Sight.PASSED), int(Sight.HIDDEN))
    seen = torch.where(known > 0, passed, int(Sight.UNSEEN))
    return torch.where(hit, int(Sight.HIT), seen).to(torch.uint8)


def network_inputs(evidence: Float[Tensor, "B 4 X Y Z"]) -> Float[Tensor, "B 5 X Y Z"]:
    """Return the evidence as input of a network, every channel within -2.1 to 2.1; probabilities are added."""
    log_odds = evidence[:, LOG_ODDS : LOG_ODDS + 1]
    return torch.cat([log_odds / 3, log_odds.sigmoid(), evidence[:, LOG_ODDS + 1 :]], dim=1)
