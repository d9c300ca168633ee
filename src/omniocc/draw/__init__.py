"""Images of data and predictions: numpy (height, width, 3) uint8 RGB."""

from omniocc.draw.bev import bev, error_bev
from omniocc.draw.canvas import save_png
from omniocc.draw.compare import SheetParts, comparison_parts, comparison_sheet
from omniocc.draw.depth import depth_sheet, predicted_sheet
from omniocc.draw.sketch import sketch_sheet
from omniocc.draw.voxels import render_voxels

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
