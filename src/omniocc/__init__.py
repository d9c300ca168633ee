"""Camera-based 3D semantic occupancy for vehicles with fisheye cameras."""

__version__ = "0.1.0"
