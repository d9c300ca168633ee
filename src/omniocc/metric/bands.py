"""Distance bands in which scores are given."""

RANGE_EDGES_M = (0.0, 8.5, 17.0, 25.6)
"""The paper's distance bands (its Table 'result in different distance')."""
