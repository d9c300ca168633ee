"""A page in one file, in which voxels can be turned: made by Python from frames, drawn by the modules in `static`."""

from omniocc.extras.viewer.page.write import page_path, write_page

__all__ = ["page_path", "write_page"]
