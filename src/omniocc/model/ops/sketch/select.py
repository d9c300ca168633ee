"""From probabilities to candidates."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def above(probability: Float[Tensor, "B X Y Z"], threshold: float) -> Bool[Tensor, "B X Y Z"]:
    """Return the cells at least this likely to be occupied."""
    return probability >= threshold


def likeliest(probability: Float[Tensor, "B X Y Z"], fraction: float) -> Bool[Tensor, "B X Y Z"]:
    """Return the round(fraction * cells) likeliest cells of each sample, ties included in this number."""
    cells = probability.flatten(1)
    chosen = cells.topk(round(fraction * cells.shape[1]), dim=1, sorted=False).indices
    return torch.zeros_like(cells, dtype=torch.bool).scatter_(1, chosen, True).reshape(probability.shape)
