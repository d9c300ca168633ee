"""A page in one file, in which voxels can be turned: made by Python from frames, drawn by the modules in `static`."""

from omniocc.viewer.page.write import PAGE, frame_address, page_path, write_page

__all__ = ["PAGE", "frame_address", "page_path", "write_page"]
