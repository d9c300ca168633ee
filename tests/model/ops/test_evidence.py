import pytest
import torch

from omniocc.model.ops.evidence import (
    Sight,
    network_inputs,
    pack_evidence,
    sight_of,
    unpack_evidence,
)
from omniocc.model.protocols import Sketched


def test_eight_bits_keep_log_odds_to_a_tenth_and_the_sight():
    log_odds = torch.linspace(-6.3, 6.3, 400).reshape(4, 5, 4, 5)
    sight = torch.randint(0, 4, log_odds.shape, dtype=torch.uint8)
    bits = pack_evidence(log_odds, sight)
    assert bits.dtype == torch.uint8
    evidence = unpack_evidence(bits)
    assert evidence.shape == (4, 4, 5, 4, 5)
    assert float((evidence[:, 0] - log_odds).abs().max()) <= 0.1 + 1e-5
    for channel, value in enumerate((Sight.HIT, Sight.PASSED, Sight.HIDDEN), start=1):
        assert torch.equal(evidence[:, channel], (sight == value).float())


def test_every_byte_survives_unpacking_and_packing():
    bits = torch.arange(256, dtype=torch.uint8).reshape(1, 4, 8, 8)
    log_odds, *seen = unpack_evidence(bits).unbind(1)
    sight = sum(value * one for value, one in zip((Sight.HIT, Sight.PASSED, Sight.HIDDEN), seen, strict=True))
    assert torch.equal(pack_evidence(log_odds, sight.to(torch.uint8)), bits)


def test_log_odds_beyond_the_limit_are_cut_off():
    bits = pack_evidence(torch.tensor([[[-90.0, 90.0]]]), torch.zeros(1, 1, 2, dtype=torch.uint8))
    assert unpack_evidence(bits)[0].flatten().tolist() == pytest.approx([-6.3, 6.3])


def test_sight_says_hit_before_passed_before_hidden_before_unseen():
    hit = torch.tensor([True, True, False, False, False])
    known = torch.tensor([1.0, 0.0, 0.5, 0.5, 0.0])
    gap = torch.tensor([-1.0, 0.0, 0.3, -0.3, 0.0])
    names = [Sight(value).name for value in sight_of(hit, known, gap).tolist()]
    assert names == ["HIT", "HIT", "PASSED", "HIDDEN", "UNSEEN"]


def test_inputs_of_networks_hold_the_probability_as_well():
    evidence = torch.zeros(1, 4, 1, 1, 2)
    evidence[0, 0, 0, 0] = torch.tensor([3.0, -3.0])
    evidence[0, 2] = 1
    inputs = network_inputs(evidence)
    assert inputs[0, :, 0, 0, 0].tolist() == pytest.approx([1.0, 1 / (1 + 2.718281828**-3), 0, 1, 0])
    assert inputs[0, :2, 0, 0, 1].tolist() == pytest.approx([-1.0, 1 / (1 + 2.718281828**3)])


def test_a_sketch_without_evidence_is_named():
    with pytest.raises(ValueError, match="its sketch has none: choose model/sketch=omni"):
        Sketched(torch.ones(1, 2, 2, 2, dtype=torch.bool)).evidence()
