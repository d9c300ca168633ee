"""Images of data and predictions: numpy (height, width, 3) uint8 RGB."""

from omniocc.view.bev import bev, error_bev
from omniocc.view.canvas import save_png
from omniocc.view.compare import SheetParts, comparison_parts, comparison_sheet
from omniocc.view.depth import depth_sheet
from omniocc.view.predicted import predicted_sheet
from omniocc.view.sketch import sketch_sheet
from omniocc.view.voxels import render_voxels

__all__ = [
    "SheetParts",
    "bev",
    "comparison_parts",
    "comparison_sheet",
    "depth_sheet",
    "error_bev",
    "predicted_sheet",
    "render_voxels",
    "save_png",
    "sketch_sheet",
]
