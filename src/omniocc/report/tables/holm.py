"""Holm's correction for several tests of one family."""

import math
from collections.abc import Sequence


def holm(p_values: Sequence[float], tests: int = 0) -> list[float]:
    """Return p-values adjusted for their number, or for `tests` where more are planned than done, in the same order.

    A p-value that is nan is not known; it stays, and counts only among `tests`.

    Rejecting all hypotheses whose adjusted p-value is below alpha keeps the probability of one wrong rejection or more
    below alpha, whatever the tests have in common. Holm, 'A simple sequentially rejective multiple test procedure',
    Scandinavian Journal of Statistics 6, 1979.

    Example:
        >>> [round(p, 3) for p in holm([0.01, 0.04, 0.03])]
        [0.03, 0.06, 0.06]
    """
    adjusted, largest = [math.nan] * len(p_values), 0.0
    order = sorted((k for k, p_value in enumerate(p_values) if not math.isnan(p_value)), key=lambda k: p_values[k])
    tests = max(tests, len(order))
    for rank, place in enumerate(order):
        largest = max(largest, min(1.0, (tests - rank) * p_values[place]))
        adjusted[place] = largest
    return adjusted
