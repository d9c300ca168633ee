"""Holm's correction."""

import itertools

import numpy as np
import pytest

from omniocc.report.tables.holm import holm


def test_as_r_adjusts():
    """`p.adjust(c(0.01, 0.02, 0.03, 0.04), "holm")` and `p.adjust(c(.03, .001, .9, .001, .2), "holm")` of R."""
    assert holm([0.01, 0.02, 0.03, 0.04]) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert holm([0.03, 0.001, 0.9, 0.001, 0.2]) == pytest.approx([0.09, 0.005, 0.9, 0.005, 0.4])
    assert holm([]) == []
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([0.01, np.nan, 0.02]) == pytest.approx([0.02, np.nan, 0.02], nan_ok=True)
    assert holm([0.01, np.nan], tests=4) == pytest.approx([0.04, np.nan], nan_ok=True)


def test_it_is_the_closed_test_of_bonferronis():
    """A hypothesis is rejected if every set of hypotheses that has it is rejected by Bonferroni's smallest p-value."""
    for p_values in np.random.default_rng(0).uniform(0, 0.4, (20, 5)):
        sets = [chosen for size in range(1, 6) for chosen in itertools.combinations(range(5), size)]
        closed = [
            max(min(1.0, len(chosen) * min(p_values[j] for j in chosen)) for chosen in sets if k in chosen)
            for k in range(5)
        ]
        assert holm(list(p_values)) == pytest.approx(closed)
