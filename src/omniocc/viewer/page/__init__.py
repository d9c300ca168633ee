"""A page in one file, in which voxels can be turned: made by Python from frames, drawn by the modules in `static`."""

from omniocc.viewer.page.write import PAGE, page_path, write_page

__all__ = ["PAGE", "page_path", "write_page"]
