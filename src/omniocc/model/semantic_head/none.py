"""No semantic head."""

from torch import nn

from omniocc.model.ops.padded import FeatureMaps


class NoSemanticHead(nn.Module):
    """Classify no pixels."""

    def __init__(self):  # of its own: nn.Module's would accept anything
        super().__init__()

    def forward(self, features: FeatureMaps) -> None:
        """Return None."""
        return
