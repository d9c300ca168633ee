"""Camera models and rigs: from points to pixels and back, at any angle."""

from omniocc.camera.equidistant import Equidistant
from omniocc.camera.equirectangular import Equirectangular
from omniocc.camera.pinhole import Pinhole
from omniocc.camera.pixels import normalize_pixels
from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

__all__ = ["Camera", "Equidistant", "Equirectangular", "Pinhole", "Rig", "normalize_pixels"]
