"""No semantic head."""

from typing import ClassVar

from torch import nn

from omniocc.model.ops.padded import FeatureMaps


class NoSemanticHead(nn.Module):
    """Classify no pixels."""

    CLASSIFIES: ClassVar[bool] = False

    def __init__(self):  # of its own: nn.Module's would accept anything
        super().__init__()

    def forward(self, features: FeatureMaps) -> None:
        """Return None."""
        return
