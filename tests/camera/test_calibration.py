"""Calibration files as other tools write them, and the errors for broken ones."""

import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import EUCM, MEI, DoubleSphere, FTheta, KannalaBrandt, OCam, Pinhole, Rig
from omniocc.camera.pose import pose_from_angles

OPENCV = """%YAML:1.0
---
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 3.0245305983229298e+02, 0., 4.9664001463163459e+02, 0.,
       3.2074618594392325e+02, 3.3119980984361649e+02, 0., 0., 1. ]
dist_coeffs: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -4.3735601598704078e-02, 2.1692522970939803e-02,
       -2.6388839028513571e-02, 8.4123126605702321e-03 ]
resolution: !!opencv-matrix
   rows: 2
   cols: 1
   dt: i
   data: [ 960, 640 ]
"""
ROS = """
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [300.0, 0, 320, 0, 301.0, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
NCORE = """{"resolution": [960, 540], "shutter_type": "ROLLING_TOP_TO_BOTTOM", "external_distortion_parameters": null,
 "principal_point": [477.8616638183594, 371.405029296875], "reference_poly": "ANGLE_TO_PIXELDIST",
 "pixeldist_to_angle_poly": [0.0, 0.002108694054186344, 1.4248414004214283e-07, -8.064807710539412e-10,
  2.485065538765374e-12, -1.7939406081105393e-15],
 "angle_to_pixeldist_poly": [0.0, 473.61334228515625, -9.587550163269043, 24.94717788696289, -42.338558197021484,
  15.140613555908203],
 "max_angle": 1.3461724520632263,
 "linear_cde": [0.9997570514678955, 6.27807603450492e-05, -0.00010061755892820656]}
"""
DRIVEWORKS = """{"rig": {"sensors": [
    {"name": "camera:front:wide:120fov", "protocol": "camera.virtual",
     "nominalSensor2Rig_FLU": {"roll-pitch-yaw": [0.0, 10.0, 30.0], "t": [1.0, -0.2, 1.5]},
     "correction_sensor_R_FLU": {"roll-pitch-yaw": [5.0, 0.0, 0.0]}, "correction_rig_T": [0.0, 0.0, 0.25],
     "properties": {"Model": "ftheta", "cx": "960", "cy": "604", "width": "1920", "height": "1208",
      "bw-poly": "0.0 0.00102186773438007 6.5174766916698e-08 -8.68132649101128e-11 9.99595439516061e-14"}},
    {"name": "lidar:top", "protocol": "lidar.virtual", "properties": {"Model": "none"}},
    {"name": "camera:rear:70fov", "protocol": "camera.virtual",
     "nominalSensor2Rig_FLU": {"roll-pitch-yaw": [0, 0, 180], "t": [-1.0, 0.2, 1.25]},
     "properties": {"Model": "ftheta", "cx": "640.5", "cy": "360", "width": "1280", "height": "720",
      "polynomial": "0 700 -3.5", "polynomial-type": "angle-to-pixeldistance",
      "linear-c": "1.01", "linear-d": "0.002", "linear-e": "-0.003"}}]},
 "version": 7}
"""
KALIBR = """
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.0125, 0.0578, -8.5e-02, 4e-2]
  distortion_model: equidistant
  intrinsics: [461.5, 460.2, 366.2, 249.0]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: omni
  distortion_coeffs: [0.0168, 1.6549, 0.00042, 0.000425]
  distortion_model: radtan
  intrinsics: [2.2134, 1336.3, 1335.8, 716.9, 705.8]
  resolution: [1400, 1400]
cam2:
  T_cn_cnm1:
  - [0.0, 0.0, -1.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.24425, 0.56574, 348.1, 347.1, 365.8, 249.4]
  resolution: [752, 480]
cam3:
  T_cn_cnm1: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: eucm
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [0.58647, 1.13925, 460.9, 459.6, 365.8, 248.9]
  resolution: [752, 480]
"""
OCAMCALIB = """\
#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). These are used by cam2world

5 -1.966560e+02 0.000000e+00 3.053428e-03 -9.784996e-06 2.278718e-08

#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). These are used by world2cam

13 300.888356 180.967781 -21.353055 14.896848 31.7861 -12.778866 -10.889768 20.862822 6.557302 -10.383775 -2.519069 \
2.891402 1.028544

#center: "row" and "column", starting from 0 (C convention)

383.000000 399.000000

#affine parameters "c", "d", "e"

1.000000 0.000000 0.000000

#image size: "height" and "width"

768 800
"""
KITTI360 = """%YAML:1.0
---
model_type: MEI
camera_name: image_03
image_width: 1400
image_height: 1400
mirror_parameters:
   xi: 2.5535139132482758e+00
distortion_parameters:
   k1: 4.9370396274089505e-02
   k2: 4.5068455478645308e+00
   p1: 1.3477698472982495e-03
   p2: -7.0340482615055284e-04
projection_parameters:
   gamma1: 1.4854388981875156e+03
   gamma2: 1.4849477411748708e+03
   u0: 6.9888316784030962e+02
   v0: 6.9814541887723055e+02
"""
KITTI360_POSES = """\
image_00: 0.0371783278 -0.0986182135 0.9944306009 1.5752681039 0.9992675562 -0.0053553387 -0.0378902567 \
0.0043914093 0.0090621821 0.9951109327 0.0983468786 -0.6500000000
image_02: 0.9999 0.0 0.01414143 0.7 0.01414143 0.0 -0.9999 -0.8 0.0 1.0 0.0 -1.1
image_03: -0.9996821702 0.0005703407 -0.0252038325 0.7016842127 -0.0252033830 0.0007820814 0.9996820384 0.7463650950 \
0.0005898709 0.9999995315 -0.0007674583 -1.0751978255
"""
OMNIMVS = """
config: {omnimvs_sweep_min_depth: 1.65}
# polynomial coefficients for the DIRECT mapping function: the files of the real datasets have OCamCalib's comments
dataset: {img_fmt: "cam%d/%04d.png"}
cameras:
  - cam_id: 1
    model: "ocam"
    poly: [5, -1.966560e+02, 0.0, 3.053428e-03, -9.784996e-06, 2.278718e-08]
    inv_poly: [3, 300.0, 180.0, -21.0]
    center: [383.0, 399.0]
    affine: [1.0, 0.0, 0.0]
    image_size: [768, 800]
    invalid_mask: "mask1.png"
    pose: [0.0, 0.0, 0.0, 0.0, 0.0, 0.6]
    max_fov: 220.0
  - {cam_id: 2, model: "ocam", center: [383.0, 399.0], affine: [1.0, 0.0, 0.0], image_size: [768, 800], max_fov: 220.0,
     poly: [5, -1.952845e+02, 0.0, 3.144e-03, -1.2e-05, 2.486384e-08], inv_poly: [3, 320.0, 190.0, -49.0],
     pose: [0.0, 1.570796326794897, 0.0, 0.6, 0.0, 0.0]}
"""


@pytest.fixture
def load(tmp_path):
    def write_and_load(text, name="some.yaml"):
        (tmp_path / name).write_text(text)
        return Rig.load(tmp_path / name)

    return write_and_load


def test_opencv_fisheye(load, known, build_camera):
    rig = load(OPENCV, "front.yaml")
    assert rig.cameras == (build_camera(known["cameras"]["svs_front"]),)
    assert rig.names == ("front",)
    assert rig.ego_from_camera[0].tolist() == [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]


def test_file_written_by_opencv_is_read(tmp_path):
    matrix, k = np.array([[300.0, 0, 320], [0, 301, 240], [0, 0, 1]]), np.array([[0.1], [-0.2], [0.03], [0.0]])
    storage = cv2.FileStorage(str(tmp_path / "c.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", matrix)
    storage.write("distortion_coefficients", k)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.release()
    expected = KannalaBrandt(640, 480, (300.0, 301.0), (320.0, 240.0), (0.1, -0.2, 0.03, 0.0), 180.0)
    assert Rig.load(tmp_path / "c.yml").cameras == (expected,)


def test_ros_camera_info(load):
    assert load(ROS).cameras == (Pinhole(640, 480, (300.0, 301.0), (320.0, 240.0)),)
    fisheye = ROS.replace("plumb_bob", "equidistant").replace("cols: 5, data: [0, ", "cols: 4, data: [")
    assert load(fisheye).cameras == (
        KannalaBrandt(640, 480, (300.0, 301.0), (320.0, 240.0), (0.0, 0.0, 0.0, 0.0), 180.0),
    )


def test_kalibr_camchain(load):
    rig = load(KALIBR)
    assert rig.names == ("cam0", "cam1", "cam2", "cam3")
    brandt, mei, double, unified = rig.cameras
    assert brandt == KannalaBrandt(752, 480, (461.5, 460.2), (366.2, 249.0), (-0.0125, 0.0578, -0.085, 0.04), 180.0)
    assert mei == MEI(1400, 1400, (1336.3, 1335.8), (716.9, 705.8), 2.2134, (0.0168, 1.6549, 0.00042, 0.000425), 180.0)
    assert double == DoubleSphere(752, 480, (348.1, 347.1), (365.8, 249.4), -0.24425, 0.56574, 180.0)
    assert unified == EUCM(752, 480, (460.9, 459.6), (365.8, 248.9), 0.58647, 1.13925, 180.0)
    steps = rig.ego_from_camera[:, :3, 3] - rig.ego_from_camera[0, :3, 3]
    # cam1 lies 0.11 m to the right of cam0; cam2's origin is 0.2 m behind cam1 along cam2's z, which is cam1's x
    expected = [[0, 0, 0], [0, -0.11, 0], [0, 0.09, 0], [0, 0.09, 0]]
    torch.testing.assert_close(steps, torch.tensor(expected, dtype=torch.float64), atol=1e-12, rtol=0)
    torch.testing.assert_close(rig.ego_from_camera[:, :3, 3].mean(0), torch.zeros(3, dtype=torch.float64))
    assert rig.ego_from_camera[2, :3, 2].tolist() == pytest.approx([0, -1, 0]), "cam2 looks to the right"


def test_ocamcalib_text(load, known, build_camera):
    camera = build_camera(known["cameras"]["omnimvs_sunny_single_cam1"])
    rig = load(OCAMCALIB, "calib_results.txt")
    (read,) = rig.cameras
    assert isinstance(read, OCam)
    assert read.max_angle_deg == 180
    assert read.polynomial == camera.polynomial
    assert read.inverse_polynomial == camera.inverse_polynomial
    assert (read.width, read.height, read.center_px) == (800, 768, (399.0, 383.0))
    no_comments = "\n".join(line for line in OCAMCALIB.splitlines() if not line.startswith("#"))
    assert load(no_comments, "calib_results.txt") == rig


def test_ncore_camera(load, known, build_camera):
    (camera,) = load(NCORE).cameras
    assert camera == build_camera(known["cameras"]["ncore_sample"])
    (other,) = load(NCORE.replace("ANGLE_TO_PIXELDIST", "PIXELDIST_TO_ANGLE")).cameras
    assert (other.angle_to_pixeldist, other.pixeldist_to_angle[1]) == ((), 0.002108694054186344)
    (plain,) = load(
        NCORE.replace("0.9997570514678955, 6.27807603450492e-05, -0.00010061755892820656", "0, 0, 0")
    ).cameras
    assert plain.linear_cde == (1.0, 0.0, 0.0)


def test_driveworks_rig(load, known):
    rig = load(DRIVEWORKS)
    assert rig.names == ("camera_front_wide_120fov", "camera_rear_70fov")
    front, rear = rig.cameras
    backward = tuple(known["cameras"]["driveworks_sample"]["pixeldist_to_angle_poly"])
    assert front == FTheta(1920, 1208, (960.0, 604.0), (), backward, (1.0, 0.0, 0.0), 180.0)
    assert rear == FTheta(1280, 720, (640.5, 360.0), (0.0, 700.0, -3.5), (), (1.01, 0.002, -0.003), 180.0)
    # the cameras are 1.75 and 1.25 m above the road, below which the rig's origin, their mean, lies
    assert rig.road_z_m == pytest.approx(-1.5)
    torch.testing.assert_close(
        rig.ego_from_camera[:, :3, 3], torch.tensor([[1, -0.2, 0.25], [-1, 0.2, -0.25]]).double()
    )
    # the front camera looks 10 degrees down and 30 to the left, and is rolled by 5 clockwise about where it looks
    expected = pose_from_angles((1.0, -0.2, 0.25), 30.0, -10.0, 5.0)
    torch.testing.assert_close(rig.ego_from_camera[0], expected, atol=1e-12, rtol=0)
    turned = load(DRIVEWORKS.replace('"roll-pitch-yaw": [5.0, 0.0, 0.0]', '"roll-pitch-yaw": [0, 0, 90]'))
    # 90 degrees to the left in the camera's own frame: it looks where its left was
    assert turned.ego_from_camera[0, :3, 2].tolist() == pytest.approx(
        (-rig.ego_from_camera[0, :3, 0]).tolist(), abs=0.1
    )


def test_kitti360_camera(load, known, build_camera):
    rig = load(KITTI360)
    assert rig.cameras == (build_camera(known["cameras"]["kitti360_image_03"]),)
    assert rig.names == ("image_03",)


def test_kitti360_folder_has_poses(tmp_path, load):
    load(KITTI360, "image_03.yaml")
    load(KITTI360.replace("image_03", "image_02"), "image_02.yaml")
    (tmp_path / "calib_cam_to_pose.txt").write_text(KITTI360_POSES)
    rig = Rig.load(tmp_path)
    assert rig.names == ("image_02", "image_03")
    left, right = rig.ego_from_camera
    assert left[1, 3] - right[1, 3] == pytest.approx(0.8 + 0.7463650950)
    assert left[1, 2] > 0.99, "image_02 looks to the left"
    assert right[1, 2] < -0.99
    assert right[:3, 1].tolist() == pytest.approx([0, 0, -1], abs=2e-3), "down is down"
    (tmp_path / "calib_cam_to_pose.txt").write_text(KITTI360_POSES.splitlines()[0])
    with pytest.raises(ValueError, match=r"calib_cam_to_pose\.txt: image_02.*missing.*image_00"):
        Rig.load(tmp_path)
    (tmp_path / "image_02.yaml").write_text("")
    with pytest.raises(ValueError, match=r"image_02\.yaml: the content is None; it must be a mapping"):
        Rig.load(tmp_path)


def test_omnimvs_config(tmp_path, load):
    invalid = np.zeros((768, 800), np.uint8)
    invalid[:100] = 255
    cv2.imwrite(str(tmp_path / "mask1.png"), invalid)
    rig = load(OMNIMVS, "config.yaml")
    assert rig == Rig.load(tmp_path), "a folder is read by its config.yaml"
    assert rig.names == ("cam1", "cam2")
    assert rig.cameras[0].max_angle_deg == 110
    assert rig.cameras[0].inverse_polynomial == (300.0, 180.0, -21.0)
    assert rig.masks is not None
    assert torch.equal(rig.masks[0], torch.from_numpy(invalid == 0))
    assert rig.masks[1] is None
    front, right = rig.ego_from_camera
    torch.testing.assert_close(front[:3, 3], torch.tensor([0.6, 0, 0]).double())
    torch.testing.assert_close(right[:3, 3], torch.tensor([0, -0.6, 0]).double())
    torch.testing.assert_close(front[:3, 2], torch.tensor([1.0, 0, 0]).double())
    torch.testing.assert_close(right[:3, 2], torch.tensor([0, -1.0, 0]).double(), atol=1e-12, rtol=0)


def test_rig_file_refers_to_calibration_files(tmp_path, load):
    load(OPENCV, "front.yaml")
    load(KALIBR, "chain.yaml")
    pose = "{position_m: [2, 0, -1], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}"
    text = f"cameras:\n  a: {{calibration: front.yaml, ego_from_camera: {pose}}}\n"
    rig = load(text, "rig.yaml")
    assert rig.cameras == Rig.load(tmp_path / "front.yaml").cameras
    assert rig.ego_from_camera[0, :3, 3].tolist() == [2, 0, -1]
    with pytest.raises(ValueError, match=r"rig\.yaml: camera 'a'.*chain\.yaml.* 4 cameras"):
        load(text.replace("front.yaml", "chain.yaml"), "rig.yaml")


@pytest.mark.parametrize("text", [OPENCV, ROS, KALIBR, OCAMCALIB, KITTI360, OMNIMVS])
def test_calibration_is_saved_as_rig_file(text, load, tmp_path):
    rig = load(text)
    rig.save(tmp_path / "again.yaml")
    assert Rig.load(tmp_path / "again.yaml") == rig


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (OPENCV, "0., 0., 1. ]", "0., 0.]", "camera_matrix.*3x3.* 8 numbers"),
        (OPENCV, "3.0245305983229298e+02", ".Nan", "camera_matrix is '.Nan'"),
        (OPENCV, "3.0245305983229298e+02", ".nan", "camera_matrix is nan.*finite"),
        (OPENCV, "3.0245305983229298e+02", "-5.", "focal_px is -5.0"),
        (OPENCV, "data: [ 960, 640 ]", "data: [ 960.5, 640 ]", "resolution is 960.5.*whole"),
        (OPENCV, "resolution:", "resolutoin:", "resolution or image_width is missing"),
        (OPENCV, "dist_coeffs", "dist", "dist_coeffs or distortion_coefficients is missing"),
        (OPENCV, "0., 0., 1. ]", "0., 0.", "not valid YAML"),
        (ROS, "data: [0, 0, 0, 0, 0]", "data: [0.1, 0, 0, 0, 0]", "undistort"),
        (ROS, "300.0, 0, 320", "300.0, 0.1, 320", "camera_matrix is"),
        (KALIBR, "[752, 480]\n  rostopic", "[752]\n  rostopic", "cam0: resolution.* 2 numbers"),
        (KALIBR, "[2.2134, ", "[", "cam1: intrinsics.* 5 numbers"),
        (KALIBR, "radtan", "fov", "cam1: camera_model.*omni.*distortion_model.*fov"),
        (KALIBR, "[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]", "cam1: T_cn_cnm1: its last row is"),
        (KALIBR, "- [1.0, 0.0, 0.0, -0.11]", "- [2.0, 0.0, 0.0, -0.11]", "cam1: T_cn_cnm1.*stretches"),
        (KALIBR, "- [1.0, 0.0, 0.0, -0.11]", "- [1.0, 0.0, -0.11]", "cam1: T_cn_cnm1.*row.* 4"),
        (KALIBR, "0.56574", "1.56574", "cam2: alpha is 1.56574"),
        (KALIBR, "cam1:", "cam7:", "cam1 is missing"),
        (OCAMCALIB, "5 -1.966560e+02", "6 -1.966560e+02", "polynomial.* 6 coefficients.* 5"),
        (OCAMCALIB, "5 -1.966560e+02", "5 nan", "polynomial is 'nan'"),
        (OCAMCALIB, "\n768 800\n", "", "4 lines.* 5"),
        (OCAMCALIB, "\n768 800\n", "\n768.7 800\n", r"size is '768\.7 800'; it must be whole numbers"),
        (OCAMCALIB, "\n768 800\n", "\n768 8e9\n", "more than 150 megapixels are not read"),
        (OCAMCALIB, "-1.966560e+02", "1.966560e+02", r"polynomial\[0\] is 196.656.*negative"),
        (KITTI360, "model_type: MEI", "model_type: SCARAMUZZA", "model_type.*SCARAMUZZA.*MEI"),
        (KITTI360, "   xi: 2.5535139132482758e+00\n", "   x: 0\n", "xi is missing"),
        (KITTI360, "1.4854388981875156e+03", "0.0", "focal_px is 0.0"),
        (KITTI360, "1.4854388981875156e+03", ".inf", "gamma1 is inf"),
        (NCORE, ': "ANGLE_TO_PIXELDIST"', ": 1", "reference_poly is 1; .*PIXELDIST_TO_ANGLE"),
        (NCORE, "null", "{reference_poly: FORWARD}", "windshield"),
        (NCORE, "[0.0, 473.6", "[2.0, 473.6", "angle_to_pixeldist is .*begin with 0"),
        (NCORE, '"max_angle"', '"angle"', "max_angle is missing"),
        (DRIVEWORKS, "angle-to-pixeldistance", "both", "camera:rear:70fov: polynomial-type is 'both'"),
        (DRIVEWORKS, '"ftheta", "cx": "640.5"', '"ocam", "cx": "640.5"', "camera:rear:70fov: Model is 'ocam'"),
        (DRIVEWORKS, "[-1.0, 0.2, 1.25]", "[-1.0, 0.2]", "camera:rear:70fov: t is .*3 numbers"),
        (DRIVEWORKS, "[1.0, -0.2, 1.5]", "[1.0, -0.2, -9]", "road_z_m is .*the road is below the rig"),
        (OMNIMVS, "pose: [0.0, 0.0, 0.0, 0.0, 0.0, 0.6]", "pose: [0.0]", "cam1: pose.* 6 numbers"),
        (OMNIMVS, "[3, 320.0, 190.0, -49.0]", "[3, 320.0]", "cam2: inv_poly.* 3 coefficients.* 1"),
        (OMNIMVS, "max_fov: 220.0", "max_fov: 400.0", "cam1: max_angle_deg is 200.0"),
        (OMNIMVS, 'model: "ocam"', 'model: "pinhole"', "cam1: model is 'pinhole'"),
        (OMNIMVS, OMNIMVS[OMNIMVS.index("cameras:") :], "cameras: []", "cameras.*empty"),
        (OMNIMVS, "cam_id: 2", "cam_id: 1", "camera 'cam1' stands twice"),
        (OPENCV, "resolution:", "camera_matrix: 1\nresolution:", "the key 'camera_matrix' is in line 3 already"),
        (ROS, "cols: 3, data", "cols: 3, cols: 3, data", "line 5: the key 'cols' is in line 5 already"),
        (KALIBR, "cam2:", "cam1:", "the key 'cam1' is in line 10 already"),
        (KITTI360, "   k2: 4", "   k1: 4", "line 11: the key 'k1' is in line 10 already"),
        (KITTI360, "image_width: 1400", "image_width: !!python/name:os.system", "line 5: the tag .* is none of plain"),
    ],
)
def test_broken_files_name_file_key_and_value(text, old, new, message, load):
    assert old in text
    with pytest.raises(ValueError, match=rf"(?s)some\.yaml: .*{message}"):
        load(text.replace(old, new))


@pytest.mark.parametrize("text", ["", "just words", "a: 1", "[1, 2]", "%YAML:1.0", "\x00\x01"])
def test_error_for_other_files_lists_known_formats(text, load):
    with pytest.raises(ValueError, match=r"some\.yaml: "):
        load(text)


def test_a_byte_order_mark_is_no_content(load):
    for text in (OPENCV, KALIBR, OCAMCALIB, KITTI360):
        assert load("\ufeff" + text) == load(text)


def test_a_mask_of_omnimvs_that_is_missing_beside_others_is_named(load, tmp_path):
    text = OMNIMVS.replace("     pose: [0.0, 1.57", "     invalid_mask: mask2.png, pose: [0.0, 1.57")
    assert load(text).masks is None
    cv2.imwrite(str(tmp_path / "mask1.png"), np.zeros((768, 800), np.uint8))
    with pytest.raises(ValueError, match=r"cam2: invalid_mask .*mask2\.png does not exist"):
        load(text)


def test_other_keys_may_stand_beside_the_cameras_of_kalibr(load):
    assert load("calibration_date: 2024-01-01\n" + KALIBR + "imu0: {rate_hz: 200}\n") == load(KALIBR)


def test_matrices_may_be_nested_lists(load):
    rows = "camera_matrix: [[40., 0, 32], [0, 40., 24], [0, 0, 1]]\ndist_coeffs: [[0.1], [0], [0], [0]]\n"
    (camera,) = load(rows + "resolution: [64, 48]").cameras
    assert camera == KannalaBrandt(64, 48, (40.0, 40.0), (32.0, 24.0), (0.1, 0.0, 0.0, 0.0), 180.0)
    matrix = (
        "camera_matrix: {rows: 3, cols: 3, data: [[40., 0, 32], [0, 40., 24], [0, 0, 1]]}\ndist_coeffs: [[.1,0,0,0]]"
    )
    assert load(f"{matrix}\nresolution: [64, 48]").cameras == (camera,)
    with pytest.raises(ValueError, match=r"camera_matrix is .*its rows differ in length"):
        load(rows.replace("[0, 0, 1]", "[0, 0]") + "resolution: [64, 48]")


def test_a_pose_that_stands_twice_is_named(tmp_path, load):
    load(KITTI360, "image_03.yaml")
    (tmp_path / "calib_cam_to_pose.txt").write_text(KITTI360_POSES + KITTI360_POSES.splitlines()[0])
    with pytest.raises(ValueError, match=r"calib_cam_to_pose\.txt: the pose of image_00 stands twice"):
        Rig.load(tmp_path)


def test_folder_without_calibration_and_binary_file(tmp_path):
    with pytest.raises(ValueError, match="calibration file"):
        Rig.load(tmp_path)
    (tmp_path / "image.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(ValueError, match=r"image\.png: it is no text in UTF-8: line 1 holds the byte 0x89$"):
        Rig.load(tmp_path / "image.png")
