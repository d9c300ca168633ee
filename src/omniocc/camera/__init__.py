"""Camera models and rigs: from points to pixels and back, at any angle."""

from omniocc.camera.double_sphere import DoubleSphere
from omniocc.camera.equidistant import Equidistant
from omniocc.camera.equirectangular import Equirectangular
from omniocc.camera.eucm import EUCM
from omniocc.camera.kannala_brandt import KannalaBrandt
from omniocc.camera.mei import MEI
from omniocc.camera.ocam import OCam
from omniocc.camera.pinhole import Pinhole
from omniocc.camera.pixels import normalize_pixels
from omniocc.camera.protocol import Camera
from omniocc.camera.radial_polynomial import RadialPolynomial
from omniocc.camera.rig import Rig

__all__ = [
    "EUCM",
    "MEI",
    "Camera",
    "DoubleSphere",
    "Equidistant",
    "Equirectangular",
    "KannalaBrandt",
    "OCam",
    "Pinhole",
    "RadialPolynomial",
    "Rig",
    "normalize_pixels",
]
