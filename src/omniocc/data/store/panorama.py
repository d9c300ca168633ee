"""Recorded panoramas of ranges at the size that a network predicts."""

import numpy as np
from jaxtyping import Float32

from omniocc.camera import Equirectangular


def resampled(
    range_m: Float32[np.ndarray, "H W"], given: Equirectangular, wanted: Equirectangular
) -> Float32[np.ndarray, "h w"]:
    """Return a panorama of ranges with other rows and columns.

    A pixel has the range of the recorded pixel at its centre; if that is not known, the smallest known range of those
    in the pixel, so that the sparse points of a LiDAR are kept; nan without any, and beyond the recorded edges.
    """
    if given == wanted:
        return range_m
    rows, columns = _rows(wanted, given), _nearest(wanted.width, given.width)
    inside = (rows >= 0) & (rows < given.height)
    result = np.full((wanted.height, wanted.width), np.nan, np.float32)
    result[inside] = range_m[rows[inside]][:, columns]
    known = ~np.isnan(range_m)
    if known.all():
        return result
    row, column = np.nonzero(known)
    row, column = _rows(given, wanted)[row], _nearest(given.width, wanted.width)[column]
    held = (row >= 0) & (row < wanted.height)
    smallest = np.full_like(result, np.nan)
    np.fmin.at(smallest, (row[held], column[held]), range_m[known][held])
    return np.where(np.isnan(result), smallest, result)


def _nearest(count: int, other: int) -> np.ndarray:
    """Return the cell among `other` equal parts of the full turn that holds the centre of each of `count`."""
    return ((np.arange(count) + 0.5) * other / count).astype(np.int64)


def _rows(one: Equirectangular, other: Equirectangular) -> np.ndarray:
    """Return the row of another panorama that holds the centre of each row of one; outside of it beyond its edges."""
    elevation = one.top_deg - (np.arange(one.height) + 0.5) * (one.top_deg - one.bottom_deg) / one.height
    return np.floor((other.top_deg - elevation) * other.height / (other.top_deg - other.bottom_deg)).astype(np.int64)
