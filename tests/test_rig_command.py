"""The script `rig.py`."""

import cv2
import numpy as np
import pytest
from scripts import run_script

from omniocc.camera import Rig
from omniocc.predict.export_scene import main as export


@pytest.fixture
def images(tmp_path):
    """Write an image of noise for every camera of `pinhole6`; return their folder."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "images"
    folder.mkdir()
    for name in Rig.load("pinhole6").names:
        cv2.imwrite(str(folder / f"{name}.png"), rng.integers(0, 255, (288, 512, 3), np.uint8))
    return folder


def test_a_new_rig_is_written_and_shown(tmp_path):
    result = run_script("rig.py", "new", "lens=mei", "cameras=3", "file=my rig.yaml", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert len(Rig.load(tmp_path / "my rig.yaml").cameras) == 3
    result = run_script("rig.py", "show", "my rig.yaml", "output=seen.jpg", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "\nnothing suspicious\n" in result.stdout
    assert "rear_left   mei               190 x 144 deg      0.90 m   -15 deg  6.7 px/deg" in result.stdout
    assert cv2.imread(str(tmp_path / "seen.jpg")).shape[1] == 1600


def test_a_file_that_is_there_is_replaced_only_by_force(tmp_path):
    (tmp_path / "rig.yaml").write_text("mine")
    result = run_script("rig.py", "new", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr == "file=rig.yaml: it is there already; choose another name, or replace it by force=true\n"
    assert (tmp_path / "rig.yaml").read_text() == "mine"
    assert run_script("rig.py", "new", "force=true", cwd=tmp_path).returncode == 0
    assert Rig.load(tmp_path / "rig.yaml").names == ("front", "right", "rear", "left")


def test_images_that_do_not_fit_are_named_and_drawn(images, tmp_path):
    front, rear, left, right = (images / f"{name}.png" for name in ("front", "rear", "rear_left", "rear_right"))
    cv2.imwrite(str(front), cv2.imread(str(front), cv2.IMREAD_GRAYSCALE))
    cv2.imwrite(str(rear), cv2.imread(str(rear))[:200])
    cv2.imwrite(str(left), cv2.resize(cv2.imread(str(left)), (256, 144)))
    cv2.imwrite(str(right), cv2.imread(str(right))[:, :508])
    (images / "roof.png").write_bytes(front.read_bytes())
    result = run_script("rig.py", "show", "rig=pinhole6", f"images={images}", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    lines = [line.removeprefix("look at   ") for line in result.stdout.splitlines() if line.startswith("look at")]
    assert lines[0].startswith("the height of the road is not known")
    assert lines[1].startswith(f"{rear}: the image is 512x200 px, but camera 'rear' is calibrated for 512x288 px")
    assert lines[2].startswith("images of almost the calibration's aspect ratio: 'rear_right'")
    assert lines[3].startswith("grey images beside colour images: 'front'")
    assert lines[4].endswith("no camera of the rig has this name: roof.png")
    assert len(lines) == 5
    scaled = "\nimages    'rear_left': 256x144 px, 0.5 of the calibration's 512x288 px; the rig is scaled to them\n"
    assert scaled in result.stdout
    assert (tmp_path / "rig.png").exists()


@pytest.mark.slow
def test_images_of_the_virtual_world_fit_a_new_rig(tmp_path):
    """The commands of docs/predict.md for a rig without images, at the smallest size."""
    run_script("rig.py", "new", "lens=kannala_brandt", "cameras=4", "file=my_rig.yaml", cwd=tmp_path)
    size = ("preset=smoke", "data.source.image_size=[64,48]", "scenes=1", "frames=1", "paths.data=my_world")
    result = run_script("render.py", "data.source.rig=my_rig.yaml", *size, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    (scene,) = tmp_path.glob("my_world/*/train-000-downtown")
    export([str(scene), str(tmp_path / "my_images")])
    result = run_script("rig.py", "show", "my_rig.yaml", "images=my_images", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert ": 64x48 px, 0.05 of the calibration's 1280x960 px; the rig is scaled to them\nnothing" in result.stdout


def test_a_camera_is_left_out(images, tmp_path):
    (images / "front.png").unlink()
    words = ("show", "pinhole6", f"images={images}")
    result = run_script("rig.py", *words, cwd=tmp_path)
    assert result.returncode == 1
    assert "no image of camera 'front'" in result.stderr
    result = run_script("rig.py", *words, "exclude_cameras=front", cwd=tmp_path)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["new", "lens=kanala_brandt"],
            "lens=kanala_brandt: there is no such lens model; did you mean 'kannala_brandt'?",
        ),
        (["new", "cameras=200"], "cameras=200: it must be a whole number, 1 to 100"),
        (["show"], "rig=... is needed; see python src/rig.py show --help"),
        (["show", "fisheye"], "rig=fisheye: no rig file 'fisheye'; did you mean 'fisheye6'?"),
        (["show", "fisheye6", "output=rig.gif"], "output=rig.gif: the name of an image ends with .png, .jpg, .jpeg"),
        (["show", "fisheye6", "images=none"], "images=none: there is no such folder"),
        (["show", "fisheye6", "image=none"], "image: there is no such key; did you mean images or image_bits?"),
    ],
)
def test_mistakes_are_named_in_a_line(words, message, tmp_path):
    result = run_script("rig.py", *words, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert message in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_number_that_is_none_is_named(tmp_path):
    result = run_script("rig.py", "show", "fisheye6", "image_bits=abc", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.splitlines()[1:] == ["  image_bits: 'abc' is not a whole number or null"]


def test_help_has_examples():
    for command in ("new", "show"):
        assert f"python src/rig.py {command} " in run_script("rig.py", command, "--help").stdout
    assert run_script("rig.py").returncode == 2
