"""The training loss: named terms, summed by whoever trains."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor, nn

from omniocc.loss.cross_entropy import CrossEntropy


@runtime_checkable
class HasLogits(Protocol):
    """What the losses read of a prediction (`omniocc.model.Prediction`)."""

    @property
    def logits(self) -> Float[Tensor, "B C X Y Z"]:
        """Of every voxel."""
        ...

    @property
    def pixel_logits(self) -> Float[Tensor, "B N C h w"] | None:
        """Of every pixel, or None without a semantic head."""
        ...


class Total(nn.Module):
    """Weighted terms by name; the loss is their sum (paper, eq. 3, where all weights are 1).

    Args:
        voxel: losses of (voxel logits, voxel labels).
        pixel: losses of (pixel logits, pixel labels).
        weights: factor of every term named in `voxel` and `pixel`.

    Raises:
        ValueError: if the names in `weights` are not those of the terms, or a name stands in both groups.
    """

    def __init__(self, voxel: Mapping[str, nn.Module], pixel: Mapping[str, nn.Module], weights: Mapping[str, float]):
        super().__init__()
        names = [*voxel, *pixel]
        if sorted(names) != sorted(weights):
            raise ValueError(f"loss terms {sorted(names)} and weights {sorted(weights)} must have the same names")
        self.voxel = nn.ModuleDict(dict(voxel))
        self.pixel = nn.ModuleDict(dict(pixel))
        self.weights = dict(weights)

    def set_class_counts(self, counts: Int64[Tensor, " C"]) -> None:
        """Tells the losses that weigh classes how many training voxels each has."""
        for loss in self.voxel.values():
            if isinstance(loss, CrossEntropy):
                loss.set_class_counts(counts)

    def forward(
        self, prediction: HasLogits, voxels: UInt8[Tensor, "B X Y Z"], pixel_labels: UInt8[Tensor, "B N H W"]
    ) -> dict[str, Float32[Tensor, ""]]:
        """Weighted scalar terms by name; those of pixels only where the model predicts pixels."""
        terms = {name: loss(prediction.logits, voxels) for name, loss in self.voxel.items()}
        if prediction.pixel_logits is not None:
            terms |= {name: loss(prediction.pixel_logits, pixel_labels) for name, loss in self.pixel.items()}
        return {name: self.weights[name] * term for name, term in terms.items()}
