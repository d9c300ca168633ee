"""Draws: equal for equal purposes, and as likely as their weights."""

import numpy as np
import pytest

from omniocc.seeding import choice, generator, weighted_choice


def test_generators_depend_on_theme_seed_and_purpose_only() -> None:
    first = generator("suburb", 3, "light").random(4)
    assert np.array_equal(first, generator("suburb", 3, "light").random(4))
    for other in (("downtown", 3, "light"), ("suburb", 4, "light"), ("suburb", 3, "traffic")):
        assert not np.array_equal(first, generator(*other).random(4))


def test_choices_are_as_likely_as_their_weights() -> None:
    rng = np.random.default_rng(0)
    drawn = [weighted_choice(rng, {"never": 0, "often": 3, "seldom": 1}) for _ in range(4000)]
    assert "never" not in drawn
    assert drawn.count("often") / 4000 == pytest.approx(0.75, abs=0.03)
    even = [choice(rng, ("a", "b")) for _ in range(4000)]
    assert even.count("a") / 4000 == pytest.approx(0.5, abs=0.03)
