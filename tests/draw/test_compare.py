import cv2
import numpy as np
import pytest
import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.draw import comparison_parts, comparison_sheet, save_png
from omniocc.draw.sheet import HEXAGON_ORDER, NAMES, panorama_row
from omniocc.geometry import Cuboid, Cylinder


def sheet(count, geometry, width_px=900, caption="street/0003"):
    images = np.stack([np.full((36, 64, 3), 20 * (k + 1), dtype=np.uint8) for k in range(count)])
    truth = torch.randint(0, 12, geometry.shape, dtype=torch.uint8)
    parts = comparison_parts(images, truth, truth.flip(0), geometry, WORLD_CLASSES, width_px)
    return comparison_sheet(parts, WORLD_CLASSES, caption, width_px)


def test_cameras_are_placed_by_direction():
    assert [NAMES[k] for k in HEXAGON_ORDER] == [
        "front left",
        "front",
        "front right",
        "rear left",
        "rear",
        "rear right",
    ]
    image = sheet(6, Cylinder(shape=(6, 10, 4)), caption="")
    height = (900 - 2 * 14 - 2 * 6) // 3 * 36 // 64
    for row, cameras in enumerate(((5, 0, 1), (4, 3, 2))):
        for column, camera in enumerate(cameras):
            top, left = 14 + row * (height + 6), 14 + column * 292
            assert (image[top + height // 2, left + 140] == 20 * (camera + 1)).all()


@pytest.mark.parametrize("count", [1, 4, 6, 8])
@pytest.mark.parametrize("geometry", [Cylinder(shape=(6, 10, 4)), Cuboid(shape=(6, 8, 4))], ids=["cylinder", "cuboid"])
def test_any_number_of_cameras(count, geometry):
    image = sheet(count, geometry)
    assert image.dtype == np.uint8
    assert image.shape[1:] == (900, 3)


def test_save_png_keeps_rgb(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    save_png(tmp_path / "a.png", image)
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], image)
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"file/a\.png"):
        save_png(tmp_path / "file" / "a.png", image)


def test_a_panorama_is_enlarged_pixel_by_pixel():
    small = np.random.default_rng(0).integers(0, 255, (12, 24, 3), dtype=np.uint8)
    large = panorama_row(small, "x", 240)
    assert large.shape == (120, 240, 3)
    assert np.array_equal(large[45::10, 5::10], small[4:])
