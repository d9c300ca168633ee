import torch

from omniocc.model.hints import Known, NoHints
from omniocc.model.protocols import Sketched


def test_nothing_is_handed_on():
    hints, volume = NoHints(), torch.randn(1, 3, 4, 6, 2)
    known = hints(Sketched(torch.ones(1, 4, 6, 2, dtype=torch.bool)), (), None)
    assert known == Known()
    assert hints.in_volume(volume, known) is volume
    assert hints.in_logits(known) == (None, None)
    assert not hints.EVIDENCE
    assert not list(hints.parameters())
