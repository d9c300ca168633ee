"""A rig file to begin with: cameras around a car, with every key explained."""

import difflib
import math

from omniocc.camera.rig import MAX_CAMERAS, MODELS
from omniocc.errors import UserError

Keys = tuple[tuple[str, str, str], ...]

PITCH_DEG = -15
HALF_LENGTH_M, HALF_WIDTH_M, ROAD_Z_M = 2.2, 0.9, -0.9
OCTANTS = ("front", "front_left", "left", "rear_left", "rear", "rear_right", "right", "front_right")
SIZE: Keys = (
    ("width", "1280", "px, of the images that the lens was calibrated with; images may be scaled later, not cropped"),
    ("height", "960", "px"),
)
CENTER = ("center_px", "[639.5, 479.5]", "px, where the optical axis meets the image; the middle of the first pixel is 0")
FOCAL = "px, fx and fy of the calibration; they belong to this width and height"
SEES = ("max_angle_deg", "95", "degrees off the axis that the lens sees: half its field of view; 180: the formula ends it")
LENSES: dict[str, tuple[str, Keys]] = {
    "equidistant": (
        "radius = focal_px * angle, a fisheye without further distortion",
        (*SIZE, ("focal_px", "386.0", "px per radian: 640 px for 95 degrees"), CENTER, SEES),
    ),
    "pinhole": (
        "no distortion: of images that are undistorted already; 100 degrees wide here",
        (*SIZE, ("focal_px", "[537.0, 537.0]", f"{FOCAL}; 640 px / tan(half the field of view)"), CENTER),
    ),
    "kannala_brandt": (
        "cv2.fisheye.calibrate, Kalibr's pinhole-equidistant",
        (
            *SIZE,
            ("focal_px", "[411.0, 411.0]", f"{FOCAL}: K[0][0] and K[1][1]"),
            (CENTER[0], CENTER[1], f"{CENTER[2]}: K[0][2] and K[1][2]"),
            ("coefficients", "[-0.02, 0.002, -0.001, 0.0]", "k1, k2, k3, k4: D of OpenCV"),
            SEES,
        ),
    ),
    "mei": (
        "cv2.omnidir.calibrate, Kalibr's omni-radtan, KITTI-360",
        (
            *SIZE,
            ("focal_px", "[915.0, 915.0]", f"{FOCAL}: gamma1 and gamma2"),
            CENTER,
            ("xi", "1.5", "of the calibration"),
            ("distortion", "[-0.02, 0.01, 0.0, 0.0]", "k1, k2, p1, p2"),
            SEES,
        ),
    ),
    "ocam": (
        "OCamCalib, OmniMVS",
        (
            *SIZE,
            (CENTER[0], CENTER[1], f"{CENTER[2]}; OCamCalib's file gives the row first"),
            ("polynomial", "[-386.3, 0.0, 9.274e-04, -3.561e-07, 9.234e-10]", "'direct mapping function', lowest power first"),
            ("inverse_polynomial", "[]", "'inverse mapping function', lowest power first; [] inverts the polynomial"),
            ("affine", "[1.0, 0.0, 0.0]", "c, d, e"),
            SEES,
        ),
    ),
    "double_sphere": (
        "Kalibr's ds-none",
        (
            *SIZE,
            ("focal_px", "[326.0, 326.0]", FOCAL),
            CENTER,
            ("xi", "-0.2", "of the calibration"),
            ("alpha", "0.6", "of the calibration, 0 to 1"),
            SEES,
        ),
    ),
    "eucm": (
        "Kalibr's eucm-none",
        (
            *SIZE,
            ("focal_px", "[382.0, 382.0]", FOCAL),
            CENTER,
            ("alpha", "0.6", "of the calibration, 0 to 1"),
            ("beta", "1.1", "of the calibration, above 0"),
            SEES,
        ),
    ),
    "radial_polynomial": (
        "WoodScape: radius = k1 angle + k2 angle^2 + k3 angle^3 + k4 angle^4",
        (
            *SIZE,
            ("coefficients_px", "[399.0, 0.0, -8.0, 2.0]", "k1 to k4, px per power of a radian"),
            (CENTER[0], CENTER[1], f"{CENTER[2]}: WoodScape's cx_offset + width / 2 - 0.5"),
            ("aspect", "1.0", "stretches the vertical distance from the centre: WoodScape's aspect_ratio"),
            SEES,
        ),
    ),
    "panoramic": (
        "a panorama of 360 degrees: columns are azimuths, the middle one looks along the axis; rows are elevations",
        (
            ("width", "2048", "px"),
            ("height", "512", "px"),
            ("top_deg", "45", "degrees, elevation of the upper edge"),
            ("bottom_deg", "-45", "degrees, elevation of the lower edge"),
        ),
    ),
}
"""By name in rig files: where calibrations of a lens model come from; its keys, values of an example, explanations."""

HEAD = f"""\
# A rig: the cameras of a vehicle. Every number is an example: put in your own, then look at them with
#     python src/rig.py show <this file> images=<folder of images>
#
# The ego frame, in which everything is predicted: x forward, y left, z up, in m. Its origin is yours to choose; the
# middle of the cameras is best. A camera: x right, y down, z forward, along the optical axis.
# Masks of what a camera sees of its own car: python src/mask.py --help
road_z_m: {ROAD_Z_M}                          # m, height of the road below the origin, so negative; measured with a tape
cameras:
"""
MORE = """\
    # mask: front.png                   # optional image beside this file, of the size above: 0 (black) is not used
    # instead of model and its numbers: calibration: front.yaml, a file of OpenCV, Kalibr, OCamCalib, KITTI-360
"""


def new_rig(lens: str, count: int) -> str:
    """Return the text of a rig file with `count` cameras of one lens model, evenly around a car and looking outwards.

    Raises:
        UserError: naming the lens models, or the number of cameras that is allowed.
    """
    if lens not in LENSES:
        close = difflib.get_close_matches(lens, LENSES, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise UserError(f"lens={lens}: there is no such lens model{hint}; lens models: {', '.join(MODELS)}")
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_CAMERAS:
        raise UserError(f"cameras={count}: it must be a whole number, 1 to {MAX_CAMERAS}")
    yaws_deg = [-360 * k / count for k in range(count)]
    return HEAD + "".join(_entry(lens, name, yaw, k == 0) for k, (name, yaw) in enumerate(_named(yaws_deg)))


def _named(yaws_deg: list[float]) -> list[tuple[str, float]]:
    names = [OCTANTS[round(yaw / 45) % 8] for yaw in yaws_deg]
    if len(set(names)) < len(names):
        names = [f"camera{k:02}" for k in range(len(names))]
    return [(name, yaw if yaw > -180 else yaw + 360) for name, yaw in zip(names, yaws_deg, strict=True)]


def _entry(lens: str, name: str, yaw_deg: float, explained: bool) -> str:
    """Return the entry of one camera, with comments or without."""
    source, keys = LENSES[lens]
    turn = math.radians(yaw_deg)
    place = f"[{HALF_LENGTH_M * math.cos(turn) + 0:.3f}, {HALF_WIDTH_M * math.sin(turn) + 0:.3f}, 0.0]"
    rows = [
        (f"  {name}:", "name of the camera, and of its images: front.png, front.jpg; any name will do"),
        (f"    model: {lens}", source),
        *((f"    {key}: {value}", comment) for key, value, comment in keys),
        ("    ego_from_camera:", "where the camera is and looks to, in the ego frame; or the four rows of a 4x4 matrix"),
        (f"      position_m: {place}", "m, of the lens: forward, left, up; measured, or of a calibration of the poses"),
        (f"      yaw_deg: {yaw_deg:g}", "degrees, counter-clockwise seen from above: 90 looks left, -90 right, 180 back"),
        (f"      pitch_deg: {PITCH_DEG}", "degrees, upwards: -15 looks 15 degrees down to the road"),
        ("      roll_deg: 0", "degrees, clockwise seen from behind the camera: 180 is upside down"),
    ]
    lines = [f"{text:<39} # {comment}" if explained else text for text, comment in rows]
    return "\n".join(lines) + "\n" + MORE * explained
