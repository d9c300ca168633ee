"""Scene-class affinity losses (MonoScene, Cao and de Charette 2022, eq. 3 to 6)."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn

from omniocc.classes import FREE
from omniocc.loss.soft_confusion import log_ratio, soft_confusion


def semantic_scal(confusion: Float32[Tensor, "C C"]) -> Float32[Tensor, ""]:
    """Return the mean of -(log precision + log recall + log specificity) over the target's classes, free included.

    Precision P = sum p y / sum p, recall R = sum p y / sum y, specificity S = sum (1-p)(1-y) / sum (1-y). S counts only
    where the target holds other classes too.
    """
    correct = confusion.diagonal()
    count, predicted, total = confusion.sum(1), confusion.sum(0), confusion.sum()
    other = ~torch.eye(len(correct), dtype=torch.bool, device=correct.device)
    # entry c: mass on classes other than c, over voxels whose class is not c
    rejected = (confusion * (other[:, :, None] & other[:, None, :])).sum((1, 2))
    elsewhere = total - count
    affinity = log_ratio(correct, predicted) + log_ratio(correct, count)
    affinity = affinity + torch.where(elsewhere > 0.5, log_ratio(rejected, elsewhere), 0)
    present = count > 0.5
    return -torch.where(present, affinity, 0).sum() / present.sum().clamp(min=1)


def geometric_scal(confusion: Float32[Tensor, "C C"]) -> Float32[Tensor, ""]:
    """Return -(log precision + log recall + log specificity) of occupied voxels against free ones.

    Specificity is that of the free voxels. Terms whose target class does not occur are left out.
    """
    mask = torch.arange(len(confusion), device=confusion.device) != FREE
    occupied, free = confusion[mask].sum(0), confusion[FREE]
    correct, hallucinated = occupied[mask].sum(), free[mask].sum()
    found = log_ratio(correct, correct + hallucinated) + log_ratio(correct, occupied.sum())
    left_free = log_ratio(free[FREE], free.sum())
    zero = torch.zeros_like(found)
    return -(torch.where(occupied.sum() > 0.5, found, zero) + torch.where(free.sum() > 0.5, left_free, zero))


class SceneClassAffinity(nn.Module):
    """Semantic plus geometric scene-class affinity; sums run over the known voxels of the whole batch."""

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no voxel is known."""
        confusion = soft_confusion(logits, target)
        return semantic_scal(confusion) + geometric_scal(confusion)
