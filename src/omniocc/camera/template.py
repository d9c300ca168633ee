"""A rig file to begin with: cameras around a car, with every key explained."""

import difflib
import math
import re

from omniocc.bounds import Real
from omniocc.camera.rig import MAX_CAMERAS
from omniocc.errors import UserError

HALF_LENGTH_M, HALF_WIDTH_M = 2.2, 0.9
OCTANTS = ("front", "front_left", "left", "rear_left", "rear", "rear_right", "right", "front_right")
COMMENTS_AT = 40
"""Column at which comments begin."""
SIZE = """\
width: 1280 # px, of the images of the calibration; yours may be scaled but not cropped
height: 960 # px"""
CENTER = "center_px: [639.5, 479.5] # px, column and row of the optical axis; the middle of the first pixel is 0"
SEES = "max_angle_deg: 95 # degrees off the axis that the lens sees, half its field of view; 180: the formula ends it"
LENSES = {
    "equidistant": f"""# radius = focal_px * angle, without further distortion
{SIZE}
focal_px: 386.0 # px per radian: 640 px are 95 degrees
{CENTER}
{SEES}""",
    "pinhole": f"""# no distortion, as in images that are undistorted already; here 100 degrees wide
{SIZE}
focal_px: [537.0, 537.0] # px, fx and fy, at this width and height: 640 px / tan(50 degrees)
{CENTER}""",
    "kannala_brandt": f"""# cv2.fisheye, Kalibr's pinhole-equidistant
{SIZE}
focal_px: [411.0, 411.0] # px, fx and fy, at this width and height; K[0][0] and K[1][1] of OpenCV
{CENTER}; K[0][2] and K[1][2] of OpenCV
coefficients: [-0.02, 0.002, -0.001, 0.0] # k1, k2, k3, k4; D of OpenCV
{SEES}""",
    "mei": f"""# cv2.omnidir, Kalibr's omni-radtan, KITTI-360
{SIZE}
focal_px: [915.0, 915.0] # px, at this width and height; gamma1 and gamma2 of KITTI-360
{CENTER}
xi: 1.5 # of the calibration, 0 or more
distortion: [-0.02, 0.01, 0.0, 0.0] # k1, k2, p1, p2
{SEES}""",
    "ocam": f"""# OCamCalib, OmniMVS
{SIZE}
{CENTER}; files of OCamCalib have the row first
polynomial: [-386.3, 0.0, 9.274e-04, -3.561e-07, 9.234e-10] # the direct mapping function, lowest power first
inverse_polynomial: [] # the inverse mapping function, lowest power first; []: the polynomial is inverted
affine: [1.0, 0.0, 0.0] # c, d, e
{SEES}""",
    "double_sphere": f"""# Kalibr's ds-none
{SIZE}
focal_px: [326.0, 326.0] # px, fx and fy, at this width and height
{CENTER}
xi: -0.2 # of the calibration, -1 to 1
alpha: 0.6 # of the calibration, 0 to 1
{SEES}""",
    "eucm": f"""# Kalibr's eucm-none
{SIZE}
focal_px: [382.0, 382.0] # px, fx and fy, at this width and height
{CENTER}
alpha: 0.6 # of the calibration, 0 to 1
beta: 1.1 # of the calibration, above 0
{SEES}""",
    "radial_polynomial": f"""# WoodScape: radius = k1 angle + k2 angle^2 + k3 angle^3 + k4 angle^4
{SIZE}
coefficients_px: [399.0, 0.0, -8.0, 2.0] # k1 to k4, px per power of a radian
{CENTER}; WoodScape: cx_offset + width / 2 - 0.5
aspect: 1.0 # factor on vertical distances from the centre; aspect_ratio of WoodScape
{SEES}""",
    "ftheta": f"""# NVIDIA's DriveWorks, NCore and PhysicalAI-AV; give the reference polynomial, the other one is []
{SIZE}
angle_to_pixeldist: [0.0, 392.0, -2.0, -1.0] # px per power of a radian, lowest power first
pixeldist_to_angle: [] # radians per power of a px, lowest power first; used if angle_to_pixeldist is []
linear_cde: [1.0, 0.0, 0.0] # c, d, e: column = c x + d y + cx, row = e x + y + cy; [1, 0, 0]: no shear
{CENTER}
{SEES}""",
    "panoramic": """# 360 degrees: columns are azimuths, the middle one looks along the axis; rows are elevations
width: 2048 # px
height: 512 # px
top_deg: 45 # degrees, elevation of the upper edge
bottom_deg: -45 # degrees, elevation of the lower edge""",
}
"""By name in rig files: the keys of a lens model, with the values of an example and where they come from."""
HEAD = """\
# A rig: the cameras of a vehicle. Every number is an example: put in your own, then look at the rig with
#     python src/rig.py show <this file> images=<folder of images>
# Ego frame, that of all results: x forward, y left, z up, in m; its origin is best in the middle of the cameras.
# Camera frame: x right, y down, z forward along the optical axis.
# What cameras see of their own car is masked by src/mask.py, see its --help.
road_z_m: -0.9 # m, height of the road below the origin, so it is negative; measured with a tape
cameras:
"""
POSE = """\
ego_from_camera: # the pose; or the four rows of a 4x4 matrix that takes points of the camera to the ego frame
  position_m: [{x:.3f}, {y:.3f}, 0.0] # m, of the lens: forward, left, up; measured, or of a calibration of the poses
  yaw_deg: {yaw:g} # degrees, counter-clockwise seen from above: 90 looks left, -90 right, 180 back
  pitch_deg: -15 # degrees, upwards: -15 looks 15 degrees down to the road
  roll_deg: 0 # degrees, clockwise seen from behind the camera: 180 is upside down
"""
MORE = """\
    # mask: front.png                   # optional, an image of the same size beside this file: 0 (black) is not used
    # calibration: front_opencv.yaml    # instead of the model and its keys: a file of OpenCV, Kalibr, OCamCalib ...
"""


def new_rig(lens: str, count: Real) -> str:
    """Return the text of a rig file with `count` cameras of one lens model, evenly around a car and looking outwards.

    The entry of the first camera explains every key.

    Raises:
        UserError: naming the lens models, or the numbers of cameras that are allowed.
    """
    if lens not in LENSES:
        close = difflib.get_close_matches(str(lens), LENSES, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise UserError(f"lens={lens}: there is no such lens model{hint}; lens models: {', '.join(LENSES)}")
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_CAMERAS:
        raise UserError(f"cameras={count}: it must be a whole number, 1 to {MAX_CAMERAS}")
    first, *others = [_entry(lens, name, yaw_deg) for name, yaw_deg in _places(count)]
    return _aligned(HEAD + first) + MORE + "".join(re.sub(" *#.*", "", entry) for entry in others)


def _places(count: int) -> list[tuple[str, float]]:
    """Return names and yaws, degrees, clockwise from the front; names are directions where no two would be equal."""
    yaws_deg = [-360 * k / count for k in range(count)]
    names = [OCTANTS[round(yaw / 45) % 8] for yaw in yaws_deg]
    if len(set(names)) < count:
        names = [f"camera{k:02}" for k in range(count)]
    return [(name, yaw if yaw > -180 else yaw + 360) for name, yaw in zip(names, yaws_deg, strict=True)]


def _entry(lens: str, name: str, yaw_deg: float) -> str:
    """Return the commented entry of one camera."""
    turn = math.radians(yaw_deg)
    pose = POSE.format(x=HALF_LENGTH_M * math.cos(turn), y=HALF_WIDTH_M * math.sin(turn), yaw=yaw_deg)
    keys = f"model: {lens} {LENSES[lens]}\n{pose}".replace("\n", "\n    ").rstrip(" ")
    return f"  {name}: # any name; images are called by it: {name}.png, {name}.jpg\n    {keys}"


def _aligned(text: str) -> str:
    """Return lines whose comments begin in one column, where what they explain is not longer."""
    return re.sub(r"^( *[^ #].*?) # ", lambda found: f"{found[1]:<{COMMENTS_AT - 1}} # ", text, flags=re.MULTILINE)
