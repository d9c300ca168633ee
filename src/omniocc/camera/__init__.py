"""Camera models and rigs: from points to pixels and back, at any angle."""

from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.equidistant import Equidistant
from omniocc.camera.models.equirectangular import Equirectangular
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.ftheta import FTheta
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.ocam import OCam
from omniocc.camera.models.panoramic import Panoramic
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.models.radial_polynomial import RadialPolynomial
from omniocc.camera.ops.pixels import normalize_pixels
from omniocc.camera.protocol import Camera
from omniocc.camera.rig import Rig

__all__ = [
    "EUCM",
    "MEI",
    "Camera",
    "DoubleSphere",
    "Equidistant",
    "Equirectangular",
    "FTheta",
    "KannalaBrandt",
    "OCam",
    "Panoramic",
    "Pinhole",
    "RadialPolynomial",
    "Rig",
    "normalize_pixels",
]
