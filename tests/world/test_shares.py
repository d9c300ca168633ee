"""Class shares: counted over occupied cells, set beside the authors' legend."""

import numpy as np
import pytest

from omniocc.classes import CLASSES
from omniocc.world.shares import AUTHORS_SHARES, occupied_shares, shares_table


def test_shares_count_occupied_cells_only() -> None:
    voxels = np.array([[0, 0, 255, 1], [1, 1, 11, 0]], np.uint8)
    ours = occupied_shares(voxels)
    assert ours["Road"] == pytest.approx(75)
    assert ours["Roadline"] == pytest.approx(25)
    assert sum(ours.values()) == pytest.approx(100)
    assert set(occupied_shares(np.zeros((2, 2), np.uint8)).values()) == {0.0}


def test_table_marks_what_differs_by_more_than_two_times() -> None:
    assert list(AUTHORS_SHARES) == [row.name for row in CLASSES[1:]]
    assert sum(AUTHORS_SHARES.values()) == pytest.approx(103.06)
    rows = shares_table({**AUTHORS_SHARES, "Pole": 0.73, "Wall": 1.0, "Other": 0.5}).splitlines()[1:]
    assert [row.split()[0] for row in rows if row.endswith("*")] == ["Wall", "Pole"]
