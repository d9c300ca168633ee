"""Fractions of classes: counted over occupied voxels, compared with the published ones."""

import numpy as np
import pytest

from omniocc.classes import CLASSES
from omniworld.class_fractions import (
    PUBLISHED_PERCENT,
    cells_per_class,
    fraction_table,
    occupied_percent,
)


def test_only_occupied_voxels_count():
    percent = occupied_percent(cells_per_class(np.array([[0, 0, 255, 1], [1, 1, 11, 0]], np.uint8)))
    assert percent["Road"] == pytest.approx(75)
    assert percent["Roadline"] == pytest.approx(25)
    assert sum(percent.values()) == pytest.approx(100)


def test_only_free_space_gives_zeros():
    assert set(occupied_percent(cells_per_class(np.zeros((2, 2), np.uint8))).values()) == {0.0}


def test_every_class_has_a_published_value():
    assert list(PUBLISHED_PERCENT) == [row.name for row in CLASSES[1:]]


def test_table_marks_what_differs_by_more_than_a_factor_of_two():
    lines = fraction_table(np.array([1000, 57, 14, 14, 7, 2, 0, 2, 1, 0, 0, 3])).splitlines()
    assert lines[1] == "Road           57.00      57.03"
    assert lines[6] == "Vegetation      0.00       6.83  more than a factor of two apart"
