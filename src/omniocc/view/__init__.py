"""Pictures for people: numpy uint8 RGB."""

from omniocc.view.bev import bev, error_bev
from omniocc.view.canvas import save_png
from omniocc.view.compare import comparison
from omniocc.view.voxels import render_voxels

__all__ = ["bev", "comparison", "error_bev", "render_voxels", "save_png"]
