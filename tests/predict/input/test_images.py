from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from omniocc.camera import Equidistant, KannalaBrandt, Rig
from omniocc.errors import UserError
from omniocc.predict import FrameFiles, find_frames, read_frame, resized_to_width
from omniocc.predict.input.images import describe_ignored_images, even_size, remarks

CAMERAS = (Equidistant(64, 36, 19.0, (31.5, 17.5), 95.0), Equidistant(96, 54, 28.0, (47.5, 26.5), 95.0))
RIG = Rig(CAMERAS, torch.eye(4, dtype=torch.float64).expand(2, 4, 4), ("front", "back"))


def save(path, width=64, height=36, value=90):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((height, width, 3), value, np.uint8))
    return path


def test_a_folder_with_an_image_named_as_each_camera(tmp_path):
    front, back = save(tmp_path / "front.png"), save(tmp_path / "back.jpg", 96, 54)
    save(tmp_path / "notes.png")
    assert find_frames(str(tmp_path), RIG) == [FrameFiles("", (front, back))]


def test_folders_are_frames_in_the_order_of_their_names(tmp_path):
    for name in ("0010", "0002"):
        save(tmp_path / name / "front.png")
        save(tmp_path / name / "back.png")
    (tmp_path / "empty").mkdir()
    frames = find_frames(str(tmp_path), RIG)
    assert [frame.name for frame in frames] == ["0002", "0010"]
    assert frames[1].files == (tmp_path / "0010/front.png", tmp_path / "0010/back.png")
    save(tmp_path / ".thumbnails" / "a.png")
    assert len(find_frames(str(tmp_path), RIG)) == 2
    save(tmp_path / "front.png")  # the mask of a rig file that lies here
    with pytest.raises(UserError, match=r"named as cameras, and folders of such images \(0002\)"):
        find_frames(str(tmp_path), RIG)


def test_a_folder_of_each_camera_holds_the_frames(tmp_path):
    for camera in ("front", "back", "left"):
        for frame in ("10", "9"):
            save(tmp_path / camera / f"{frame}.png")
    frames = find_frames(str(tmp_path), RIG)
    assert [frame.name for frame in frames] == ["9", "10"]
    assert frames[0].files == (tmp_path / "front/9.png", tmp_path / "back/9.png")
    assert list(remarks(frames, RIG)) == []
    (tmp_path / "back/9.png").unlink()
    with pytest.raises(UserError, match=r"back: no image of frame '9'"):
        find_frames(str(tmp_path), RIG)
    assert find_frames(str(tmp_path), RIG, ["back"])[0].files == (tmp_path / "front/9.png", None)
    (tmp_path / "back").rename(tmp_path / "bakc")
    with pytest.raises(UserError, match=r"no folder with images of camera 'back' \(is it 'bakc'\?\)"):
        find_frames(str(tmp_path), RIG)
    assert len(find_frames(str(tmp_path), RIG, ["back"])) == 2
    (tmp_path / "bakc").rename(tmp_path / "back")
    save(tmp_path / "back/10.jpg")
    with pytest.raises(UserError, match=r"back: several images of frame '10'"):
        find_frames(str(tmp_path), RIG)


def test_a_list_has_the_order_of_the_rig(tmp_path):
    paths = [save(tmp_path / "x.png"), save(tmp_path / "y.png")]
    assert find_frames([str(path) for path in paths], RIG) == [FrameFiles("", tuple(paths))]
    assert find_frames([str(paths[0]), "nothing.png"], RIG, ["back"]) == [FrameFiles("", (paths[0], None))]


def test_a_list_of_files_named_as_the_cameras_may_have_any_order(tmp_path):
    front, back = (save(tmp_path / name) for name in ("front.png", "back.png"))
    (frame,) = find_frames([str(back), str(front)], RIG)
    assert frame.files == (front, back)
    assert list(remarks([frame], RIG)) == []
    (frame,) = find_frames([str(save(tmp_path / "a.png")), str(back)], RIG)
    assert list(remarks([frame], RIG)) == ["images    front=a.png, back=back.png"]


def test_an_image_of_no_camera_of_the_rig_is_told(tmp_path):
    paths = [save(tmp_path / name) for name in ("front.png", "back.png")]
    assert describe_ignored_images(find_frames(str(tmp_path), RIG), RIG) == ""
    save(tmp_path / "left.png")
    assert "left.png" in describe_ignored_images(find_frames(str(tmp_path), RIG, ["back"]), RIG)
    listed = find_frames([str(tmp_path / "left.png"), str(paths[1])], RIG)
    assert describe_ignored_images(listed, RIG) == ""


def test_a_lens_that_ends_near_its_axis_is_told_beside_images_that_are_not_used(tmp_path):
    for name in ("front.png", "back.png", "left.png"):
        save(tmp_path / name)
    frames = find_frames(str(tmp_path), RIG)
    assert len(list(remarks(frames, RIG))) == 1
    narrow = KannalaBrandt(64, 36, (19.0, 19.0), (31.5, 17.5), (-0.9, 0.1, 0, 0), 100.0)
    ignored, lens = remarks(frames, Rig((narrow, CAMERAS[1]), RIG.ego_from_camera, RIG.names))
    assert "left.png" in ignored
    assert lens.startswith("camera 'front': only ")


@pytest.mark.parametrize(("road_z_m", "line"), [(-0.9, None), (-60.0, "60.0 m below the lowest camera")])
def test_a_road_that_cannot_be_is_told(tmp_path, road_z_m, line):
    for name in ("front.png", "back.png"):
        save(tmp_path / name)
    told = list(remarks(find_frames(str(tmp_path), RIG), replace(RIG, road_z_m=road_z_m)))
    assert told == (
        [] if line is None else [f"road      the road (road_z_m: {road_z_m:g}) is {line}: is it in metres?"]
    )


def test_a_camera_that_is_left_out_is_black(tmp_path):
    save(tmp_path / "front.png")
    (frame,) = find_frames(str(tmp_path), RIG, ["back"])
    images = read_frame(frame, RIG)
    assert images[0].any()
    assert images[1].shape == (54, 96, 3)
    assert not images[1].any()


@pytest.mark.parametrize(
    ("files", "excluded", "words"),
    [
        (["front.png"], [], ["'back'", "back.png", "exclude_cameras=[back]"]),
        (["front.png", "bcak.png"], [], ["'back'", "is it 'bcak'?"]),
        (["front.png", "back.png", "back.jpg"], [], ["several images", "back.jpg, back.png"]),
        (["front.png", "back.png"], ["bakc"], ["exclude_cameras=bakc", "is it 'back'?", "front, back"]),
        (["front.png"], ["front", "back"], ["every camera"]),
        ([], [], ["'front'"]),
    ],
)
def test_problems_of_a_folder_are_named(files, excluded, words, tmp_path):
    for name in files:
        save(tmp_path / name)
    with pytest.raises(UserError) as caught:
        find_frames(str(tmp_path), RIG, excluded)
    for word in words:
        assert word in str(caught.value)


def test_wrong_lists_and_folders(tmp_path):
    image = str(save(tmp_path / "front.png"))
    with pytest.raises(UserError, match=r"1 image.* 2 cameras.*front, back"):
        find_frames([image], RIG)
    with pytest.raises(UserError, match=r"nowhere\.png.*back"):
        find_frames([image, "nowhere.png"], RIG)
    with pytest.raises(UserError, match="no such folder"):
        find_frames(str(tmp_path / "nowhere"), RIG)
    with pytest.raises(UserError, match=r"list.*camera"):
        find_frames(image, RIG)


def test_damaged_and_cropped_images_are_named(tmp_path):
    front, back = tmp_path / "front.png", save(tmp_path / "back.png", 96, 54)
    front.write_bytes(b"not an image")
    with pytest.raises(UserError, match=r"front\.png.*damaged.*exclude_cameras=\[front\]"):
        read_frame(FrameFiles("", (front, back)), RIG)
    save(front, 64, 48)
    with pytest.raises(UserError, match=r"64x48 px.*front.*64x36 px"):
        read_frame(FrameFiles("", (front, back)), RIG)


def test_an_image_that_is_cut_off_is_named(tmp_path):
    path = tmp_path / "front.jpg"
    whole = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (36, 64, 3), np.uint8))[1].tobytes()
    path.write_bytes(whole)
    assert read_frame(FrameFiles("", (path, None)), RIG)[0].shape == (36, 64, 3)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match=r"front\.jpg.*incomplete"):
        read_frame(FrameFiles("", (path, None)), RIG)


def test_the_order_of_colours_is_rgb(tmp_path):
    path = tmp_path / "front.png"
    cv2.imwrite(str(path), np.full((36, 64, 3), (10, 20, 30), np.uint8))  # OpenCV writes BGR
    assert read_frame(FrameFiles("", (path, None)), RIG)[0][0, 0].tolist() == [30, 20, 10]


@pytest.mark.parametrize(("width", "size"), [(None, (64, 36)), (32, (32, 18)), (100, (96, 54))])
def test_images_and_rig_are_brought_to_one_even_size(width, size):
    images = [np.full((72, 128, 3), 255, np.uint8), np.zeros((54, 96, 3), np.uint8)]
    images[0][:, :64] = 0  # the right half is white
    batch, rig = resized_to_width(images, RIG, width)
    assert batch.shape == (1, 2, 3, size[1], size[0])
    assert {(camera.width, camera.height) for camera in rig.cameras} == {size}
    half = size[0] // 2
    assert batch[0, 0, :, :, : half - 1].max() == 0
    assert batch[0, 0, :, :, half + 1 :].min() == 1
    # the ray ahead is projected to the middle of both images, whatever their size
    pixels, valid = rig.project(torch.tensor([[0.0, 0.0, 1.0]]))
    assert valid.all()
    assert torch.allclose(pixels, torch.tensor([(size[0] - 1) / 2, (size[1] - 1) / 2]), atol=1e-4)


def test_sizes_keep_the_aspect_ratio_where_possible():
    for size, width, expected in (
        ((960, 640), 512, (510, 340)),
        ((1920, 1080), 1024, (1024, 576)),
        ((1283, 961), 512, (512, 384)),
        ((1283, 961), 1283, (1282, 960)),
        ((848, 800), 198, (198, 186)),  # 106x100 would have a quarter of the pixels
    ):
        camera = KannalaBrandt(*size, (300.0, 300.0), (size[0] / 2, size[1] / 2), (0.0,) * 4, 90.0)
        assert even_size(camera, width) == expected


def test_lenses_with_one_focal_length_are_stretched_to_the_size_of_the_first():
    square = Equidistant(64, 64, 19.0, (31.5, 31.5), 95.0)
    rig = Rig((CAMERAS[0], square), RIG.ego_from_camera, RIG.names)
    _, scaled = resized_to_width([np.zeros((36, 64, 3), np.uint8)] * 2, rig, 64)
    pixel, ray = torch.tensor([40.0, 20.0]), square.unproject(torch.tensor([40.0, 20.5 * 64 / 36 - 0.5]))[0]
    torch.testing.assert_close(scaled.cameras[1].unproject(pixel)[0], ray)


@pytest.mark.parametrize("width", [0, -5, 32.5, True, "wide"])
def test_widths_that_cannot_be_are_named(width):
    with pytest.raises(UserError, match=f"image_width={width}: give a whole number of px, 16 or more"):
        resized_to_width([np.zeros((36, 64, 3), np.uint8)] * 2, RIG, width)


def test_images_are_not_turned_and_have_their_true_depth(tmp_path):
    image, exif = np.zeros((36, 64, 3), np.uint8), Image.Exif()
    image[:18, :32] = 200
    exif[0x0112] = 3
    Image.fromarray(image).save(tmp_path / "front.png", exif=exif)
    ramp = np.linspace(0, 4095, 54 * 96).round().astype(np.uint16).reshape(54, 96)
    cv2.imwrite(str(tmp_path / "back.png"), ramp)
    (frame,) = find_frames(str(tmp_path), RIG, image_bits=12)
    front, back = read_frame(frame, RIG)
    assert np.array_equal(front, image)
    assert np.array_equal(back[..., 2], (ramp * (255 / 4095)).round())
    (frame,) = find_frames(str(tmp_path), RIG)
    with pytest.raises(UserError, match=r"back\.png: .* reach 4095.*set image_bits=12"):
        read_frame(frame, RIG)
    with pytest.raises(UserError, match=r"image_bits is 99; it must be 8 to 16"):
        find_frames(str(tmp_path), RIG, image_bits=99)
