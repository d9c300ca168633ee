import pytest
import torch

from omniocc.model.ops.sketch.select import above, likeliest


def test_above_includes_the_threshold():
    probability = torch.tensor([0.1, 0.5, 0.49999, 0.9]).reshape(1, 4, 1, 1)
    assert above(probability, 0.5).flatten().tolist() == [False, True, False, True]


@pytest.mark.parametrize(("fraction", "count"), [(0.25, 96), (0.1, 38), (1.0, 384)])
def test_fraction_is_exact_in_every_sample(fraction, count):
    probability = torch.rand(3, 8, 12, 4)
    probability[1] = 0.5  # all equal
    chosen = likeliest(probability, fraction)
    assert chosen.sum((1, 2, 3)).tolist() == [count] * 3


def test_fraction_takes_the_likeliest_of_each_sample():
    probability = torch.rand(2, 8, 12, 4)
    probability[1] *= 0.1
    chosen = likeliest(probability, 0.3)
    for sample in range(2):
        assert probability[sample][chosen[sample]].min() > probability[sample][~chosen[sample]].max()
