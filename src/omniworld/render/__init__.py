"""Ray casting and shading: what cameras and LiDARs see of a `snapshot.Snapshot`.

Options: `weather` (WEATHERS), `capture` (direct camera rays) and `cubemap`; `texture/` paints the materials.
"""
