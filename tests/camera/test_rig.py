import math
import os
import pickle
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml

from omniocc.camera import Equidistant, Panoramic, Pinhole, Rig
from omniocc.camera.masks import lenses_that_do_not_fit
from omniocc.camera.pose import pose_from_angles
from omniocc.camera.rig import MODELS


def two_cameras(mask=None):
    cameras = (Equidistant(40, 20, 12.0, (19.5, 9.5), 95.0), Pinhole(30, 20, (15.0, 16.0), (14.5, 9.0)))
    poses = [pose_from_angles((0.9, 0.1, 0.2), 12.3, -4.5, 6.7), pose_from_angles((-0.9, 0.0, 0.0), 180.0, 0.0, 0.0)]
    return Rig(cameras, torch.stack(poses), ("front", "rear"), None if mask is None else (mask, None))


def test_order_of_the_hexagon():
    rig = Rig.load("fisheye6")
    assert rig.names == ("front", "front_right", "rear_right", "rear", "rear_left", "front_left")
    points = torch.tensor([[9, 0, -1], [9, -9, -1], [0, -9, -1], [-9, -9, -1], [-9, 0, -1], [0, 9, -1.0]])
    _, valid = rig.project(points)
    visible = [set(valid[:, k].nonzero()[:, 0].tolist()) for k in range(len(points))]
    assert {0, 1, 5} <= visible[0]
    assert {0, 1, 2} <= visible[1]
    assert {1, 2} <= visible[2]
    assert not {4, 5} & visible[2]
    assert {1, 2, 3} <= visible[3]
    assert {2, 3, 4} <= visible[4]
    assert {4, 5} <= visible[5]
    assert not {1, 2} & visible[5]


@pytest.mark.parametrize("name", ["fisheye6", "pinhole6"])
def test_built_in_rigs_look_outwards_and_down(name):
    rig = Rig.load(name)
    for index, yaw_deg in enumerate((0, -60, -120, 180, 120, 60)):
        pose = rig.ego_from_camera[index]
        yaw = math.radians(yaw_deg)
        flat = math.cos(math.radians(10))
        forward = [flat * math.cos(yaw), flat * math.sin(yaw), -math.sin(math.radians(10))]
        assert pose[:3, 2].tolist() == pytest.approx(forward, abs=1e-12)
        assert pose[:3, 3].tolist() == pytest.approx([0.9 * math.cos(yaw), 0.9 * math.sin(yaw), 0], abs=1e-4)
        assert rig.cameras[index].width * 9 == rig.cameras[index].height * 16


def test_fisheye_covers_190_degrees_and_has_black_corners():
    rig = Rig.load("fisheye6")
    rays, valid = rig.rays(0)
    assert rays.shape == (288, 512, 3)
    assert not valid[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert valid[144, 0]
    assert valid[144, 511]
    to_axis = rays @ rig.ego_from_camera[0, :3, 2].float()
    assert math.degrees(math.acos(float(to_axis[144, 0]))) == pytest.approx(95, abs=0.3)


def test_rays_and_project_are_inverse():
    rig = two_cameras()
    for index, camera in enumerate(rig.cameras):
        rays, valid = rig.rays(index)
        pixels, visible = rig.project(rig.ego_from_camera[index, :3, 3] + 4 * rays.double())
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        np.testing.assert_allclose(pixels[index].numpy(), np.stack([u, v], -1), atol=1e-4)
        assert torch.equal(valid, visible[index])


def test_project_keeps_dtype_and_batch_shape_also_under_autocast():
    rig = Rig.load("fisheye6")
    points = torch.rand(2, 7, 3) * 20
    pixels, valid = rig.project(points)
    assert pixels.shape == (6, 2, 7, 2)
    assert valid.shape == (6, 2, 7)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(rig.project(points)[0], pixels)
    exact, _ = rig.project(points.double())
    assert exact.dtype == torch.float64
    torch.testing.assert_close(pixels.double(), exact, rtol=0, atol=5e-4)


def test_mask_hides_pixels():
    mask = torch.ones(20, 40, dtype=torch.bool)
    mask[12:] = False
    free, hidden = two_cameras(), two_cameras(mask)
    rays, valid = free.rays(0)
    points = free.ego_from_camera[0, :3, 3].float() + rays
    _, visible_free = free.project(points)
    _, visible = hidden.project(points)
    assert visible_free[0, 12:].any()
    assert torch.equal(visible[0], visible_free[0] & mask)
    assert torch.equal(visible[1], visible_free[1])
    assert torch.equal(hidden.rays(0)[1], valid & mask)


def test_resized_scales_cameras_and_mask():
    mask = torch.zeros(20, 40, dtype=torch.bool)
    mask[:10, 4:8] = True
    rig = two_cameras(mask)
    small = Rig(rig.cameras[:1], rig.ego_from_camera[:1], rig.names[:1], (mask,)).resized(20, 10)
    expected = torch.zeros(10, 20, dtype=torch.bool)
    expected[:5, 2:4] = True
    assert torch.equal(small.masks[0], expected)
    assert small.cameras[0] == rig.cameras[0].resized(20, 10)


@pytest.mark.parametrize("with_mask", [False, True])
def test_file_round_trip_is_exact(tmp_path, with_mask):
    rig = two_cameras(torch.rand(20, 40) > 0.5 if with_mask else None)
    rig.save(tmp_path / "sub" / "car.yaml")
    loaded = Rig.load(tmp_path / "sub" / "car.yaml")
    assert loaded == rig
    assert torch.equal(loaded.ego_from_camera, rig.ego_from_camera)
    assert loaded.cameras == rig.cameras


def test_equal_rigs_have_equal_hashes():
    mask = torch.ones(20, 40, dtype=torch.bool)
    assert two_cameras() == two_cameras()
    assert len({two_cameras(), two_cameras(), two_cameras(mask)}) == 2
    moved = two_cameras().ego_from_camera.clone()
    moved[0, 0, 3] += 1e-9
    assert Rig(two_cameras().cameras, moved, ("front", "rear")) != two_cameras()
    assert two_cameras() != two_cameras(mask)
    assert two_cameras(mask) != two_cameras(~mask)


def test_pickles_without_shared_memory():
    rig = two_cameras(torch.rand(20, 40) > 0.5)
    again = pickle.loads(pickle.dumps(rig))
    assert again == rig
    points = torch.rand(9, 3) * 5
    assert torch.equal(again.project(points)[1], rig.project(points)[1])


GOOD = """
cameras:
  front:
    model: equidistant
    width: 40
    height: 20
    focal_px: 12.0
    center_px: [19.5, 9.5]
    max_angle_deg: 95
    ego_from_camera: {position_m: [0.9, 0, 0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}
"""
POSE = "{position_m: [0.9, 0, 0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("model: equidistant", "model: equidistnat", "equidistnat.*equidistant"),
        ("model: equidistant", "model: [equidistant]", r"unknown model '\['equidistant'\]'"),
        ("width: 40", "width: 400000000", "400000000x20 px; images of more than 150 megapixels"),
        ("    model: equidistant\n", "", "neither a model.*equidistant.*nor a calibration"),
        ("focal_px: 12.0", "focal_px: .nan", "focal_px is nan"),
        ("    focal_px: 12.0\n", "", "focal_px is missing"),
        ("focal_px: 12.0", "focal_px: twelve", "focal_px is 'twelve'"),
        ("max_angle_deg", "max_angel_deg", "max_angle_deg is missing"),
        ("    width: 40\n    height: 20\n", "", "width, height are missing; keys: model, width, .*, mask .optional"),
        ("max_angle_deg: 95", "max_angle_deg: 95\n    k1: 3", "unknown key k1"),
        ("yaw_deg", "yaw", "ego_from_camera.yaw_deg is missing"),
        (POSE, "[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "not rigid"),
        (POSE, "[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "determinant -1"),
        (POSE, "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]", "last row"),
        (POSE, "[1, 2, 3]", r"ego_from_camera is \[1, 2, 3\]"),
        (POSE, POSE + "\n    mask: none.png", "none.png: the file is missing"),
        (POSE, POSE + "\n    mask: wrong.png", "wrong.png.*5x4 px.*40x20 px"),
    ],
)
def test_error_names_file_camera_and_value(tmp_path, old, new, message):
    cv2.imwrite(str(tmp_path / "wrong.png"), np.zeros((4, 5), np.uint8))
    assert old in GOOD
    file = tmp_path / "car.yaml"
    file.write_text(GOOD.replace(old, new))
    with pytest.raises(ValueError, match=rf"car\.yaml: camera 'front': .*{message}"):
        Rig.load(file)


@pytest.mark.parametrize("lens", ["left_lens.yaml", "/dev/zero"])
def test_error_names_a_calibration_that_is_no_file(lens, tmp_path):
    (tmp_path / "car.yaml").write_text(f"cameras: {{left: {{calibration: {lens}, ego_from_camera: {POSE}}}}}")
    with pytest.raises(
        ValueError, match=rf"car\.yaml: camera 'left': calibration .*{lens} does not exist, or is a dev"
    ):
        Rig.load(tmp_path / "car.yaml")


def test_numbers_may_be_written_as_python_prints_them(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text(GOOD.replace("focal_px: 12.0", "focal_px: 12e0"))  # a text for YAML 1.1
    assert Rig.load(file).cameras[0].focal_px == 12.0


def test_error_names_unreadable_files(tmp_path):
    with pytest.raises(ValueError, match="'fisheye6'"):
        Rig.load("fisheye")
    for text in ("", "cameras:", "cameras: [", "camera: {}"):
        (tmp_path / "bad.yaml").write_text(text)
        with pytest.raises(ValueError, match=r"bad\.yaml: "):
            Rig.load(tmp_path / "bad.yaml")


def test_a_camera_that_stands_twice_is_named(tmp_path):
    entry = GOOD.partition("front:")[2]
    for name, message in (
        ("front", "line 11: the key 'front' is in line 3 already"),
        ("'1'", "camera '1' stands twice"),
    ):
        (tmp_path / "car.yaml").write_text(GOOD.replace("front", name.strip("'")) + f"  {name}:{entry}")
        with pytest.raises(ValueError, match=rf"car\.yaml: .*{message}; keep one$"):
            Rig.load(tmp_path / "car.yaml")


def test_files_that_refer_to_each_other_are_named(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        text = f"cameras: {{left: {{calibration: {other}.yaml, ego_from_camera: {POSE}}}}}"
        (tmp_path / f"{name}.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"a\.yaml: camera 'left': .*b\.yaml: camera 'left': .*a\.yaml leads back"):
        Rig.load(tmp_path / "a.yaml")


def test_a_value_of_many_lines_is_shown_in_part(tmp_path):
    (tmp_path / "car.yaml").write_text(GOOD.replace(POSE, f"[{'1, ' * 50_000}]"))
    with pytest.raises(ValueError, match=r"ego_from_camera is \[1, 1, .* \.\.\. .*1\]; give position_m") as caught:
        Rig.load(tmp_path / "car.yaml")
    assert len(str(caught.value)) < 2000


def test_error_names_wrong_arguments():
    rig = two_cameras()
    with pytest.raises(ValueError, match="camera 'a' stands twice"):
        Rig(rig.cameras, rig.ego_from_camera, ("a", "a"))
    with pytest.raises(ValueError, match=r"2 cameras.* 1 names"):
        Rig(rig.cameras, rig.ego_from_camera, ("a",))
    with pytest.raises(ValueError, match=r"front.*mask.*3x2 px"):
        Rig(rig.cameras, rig.ego_from_camera, rig.names, (torch.ones(2, 3, dtype=torch.bool), None))
    with pytest.raises(ValueError, match=r"rear.*ego_from_camera.*rigid"):
        Rig(
            rig.cameras,
            torch.stack([rig.ego_from_camera[0], torch.diag(torch.tensor([1.0, 1, 3, 1])).double()]),
            rig.names,
        )


def test_rig_of_every_model_is_saved_and_loaded(tmp_path, known, build_camera):
    names = (
        "svs_front",
        "basalt_test_ds",
        "euroc_eucm",
        "kitti360_image_03",
        "woodscape_like",
        "ncore_sample",
        "ftheta_wide",
    )
    cameras = [build_camera(known["cameras"][name], max_angle_deg=80.5) for name in names]
    sunny = known["cameras"]["omnimvs_sunny_single_cam1"]
    cameras += [build_camera(sunny), build_camera(sunny, exact=True), Panoramic(64, 32, 50.0, -10.5)]
    cameras += [*two_cameras().cameras]
    masks = [torch.rand(camera.height, camera.width) > 0.5 if i % 2 else None for i, camera in enumerate(cameras)]
    poses = [pose_from_angles((0.1 * i, 0.2, -0.3), 40.0 * i, -5.0, 1.0) for i in range(len(cameras))]
    rig = Rig(tuple(cameras), torch.stack(poses), tuple(f"c{i}" for i in range(len(cameras))), tuple(masks))
    assert {type(camera) for camera in cameras} == set(MODELS.values())
    rig.save(tmp_path / "all.yaml")
    loaded = Rig.load(tmp_path / "all.yaml")
    assert loaded == rig
    assert loaded.cameras == rig.cameras
    pixels, valid = loaded.project(torch.tensor([[9.0, 1, 0], [-5, 4, -1]]))
    assert pixels.shape == (12, 2, 2)
    assert valid.any()


def test_a_mask_is_what_is_not_0_in_any_format(tmp_path):
    seen = np.zeros((20, 40), bool)
    seen[3:9, 5:30] = True
    file = tmp_path / "car.yaml"
    cv2.imwrite(str(tmp_path / "ones.png"), seen.astype(np.uint8))
    cv2.imwrite(str(tmp_path / "words.png"), seen.astype(np.uint16))
    np.save(tmp_path / "bits.npy", seen)
    for name in ("ones.png", "words.png", "bits.npy"):
        file.write_text(GOOD.replace(POSE, f"{POSE}\n    mask: {name}"))
        masks = Rig.load(file).masks
        assert masks is not None
        assert torch.equal(masks[0], torch.from_numpy(seen))
    outer = tmp_path / "outer.yaml"  # a rig that takes its lens from this file has its mask, too
    outer.write_text(f"cameras: {{left: {{calibration: car.yaml, mask: null, ego_from_camera: {POSE}}}}}")
    masks = Rig.load(outer).masks
    assert masks is not None
    assert torch.equal(masks[0], torch.from_numpy(seen))
    os.mkfifo(tmp_path / "fifo.png")
    (tmp_path / "text.png").write_text("no image")
    for name, words in (("fifo.png", "a pipe"), ("text.png", "no image"), (".", "a folder")):
        file.write_text(GOOD.replace(POSE, f"{POSE}\n    mask: {name}"))
        with pytest.raises(ValueError, match=rf"car\.yaml: camera 'front': mask .*{words}"):
            Rig.load(file)


@pytest.mark.parametrize(("name", "read_as"), [("007", "7"), ("on", "True"), ("null", "None"), ("1e3:", None)])
def test_names_of_cameras_that_yaml_reads_as_something_else_are_refused(name, read_as, tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(GOOD.replace("front:", f"{name}:"))
    if read_as is None:
        with pytest.raises(ValueError, match="the name of a camera"):
            Rig.load(file)
        return
    with pytest.raises(ValueError, match=rf"rig\.yaml: the name of a camera reads as {read_as}; write it in quotes"):
        Rig.load(file)
    file.write_text(GOOD.replace("front:", f"'{name}':"))
    assert Rig.load(file).names[0] == name


def test_the_page_has_an_example_of_every_lens_model_and_of_a_matrix(tmp_path):
    page = (Path(__file__).parents[2] / "docs/how_to/own_data.md").read_text()
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    file = tmp_path / "page.yaml"
    file.write_text(next(block for block in blocks if "*pose" in block))
    rig = Rig.load(file)
    assert {name: type(camera) for name, camera in zip(rig.names, rig.cameras, strict=True)} == MODELS
    assert lenses_that_do_not_fit(rig) == ()
    matrix = yaml.safe_load(next(block for block in blocks if block.startswith("ego_from_camera")))["ego_from_camera"]
    assert torch.equal(torch.tensor(matrix, dtype=torch.float64), pose_from_angles((0.9, 0.0, 0.0), 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("size", "factor", "expected"),
    [
        ((256, 144), 0.7, (192, 108)),  # in steps of 32x18, so that it stays even
        ((256, 144), 2.0, (512, 288)),
        ((64, 36), 0.1, (32, 18)),
        ((75, 45), 0.7, (50, 30)),  # in steps of 5x3, since it is odd
        ((1280, 966), 0.7, (1280, 966)),
    ],
)
def test_a_scaled_rig_has_whole_pixels_and_keeps_its_aspect(size, factor, expected):
    pinhole = Pinhole(*size, (100.0, 100.0), ((size[0] - 1) / 2, (size[1] - 1) / 2))
    mask = torch.ones(size[1], size[0], dtype=torch.bool)
    mask[:, : size[0] // 2] = False
    rig = Rig((pinhole,) * 2, torch.eye(4, dtype=torch.float64).expand(2, 4, 4), ("a", "b"), (mask, None))
    scaled = rig.scaled(factor)
    assert (scaled.cameras[0].width, scaled.cameras[0].height) == expected
    assert scaled == rig.resized(*expected)
    assert scaled.masks[0].shape == expected[::-1]
    assert scaled.masks[1] is None
    assert Rig(rig.cameras, rig.ego_from_camera, rig.names).scaled(factor).masks is None
