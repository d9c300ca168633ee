"""Predictions in Python are those of the commands on files of the same images."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import omniocc
from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.predict.depth import predict_panoramas
from omniocc.predict.occupancy import options_of, predict_occupancy

PAGE = Path(__file__).parents[2] / "docs" / "predict.md"
pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


def drawn(rig: Rig, folder: Path) -> list[np.ndarray]:
    """Return images of large patches, at twice the size of `tiny`'s, and write them."""
    width, height = (side // (rig.cameras[0].width // 256) for side in (rig.cameras[0].width, rig.cameras[0].height))
    patches = np.random.default_rng(0).integers(0, 255, (len(rig.names), 5, 8, 3), dtype=np.uint8)
    images = [cv2.resize(one, (width, height), interpolation=cv2.INTER_NEAREST) for one in patches]
    for image, name in zip(images, rig.names, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
    return images


def test_the_lines_of_the_page_do_what_the_commands_do(composed, tmp_path, monkeypatch, capsys):
    found = {"images": drawn(Rig.load("fisheye6"), tmp_path)}
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    exec(next(block for block in blocks if "predict_ranges" in block), found)
    monkeypatch.chdir(tmp_path)
    given = ("rig=fisheye6", f"images={tmp_path}")
    options = composed(*given, "checkpoint=tiny", "overview=false", "mesh=false", name="predict_occupancy")
    predict_occupancy(options_of(options))
    written = np.load("occupancy/voxels.npz")
    voxels = found["voxels"]
    assert len(np.unique(voxels.labels)) > 3
    assert np.array_equal(voxels.labels, written["labels"])
    assert np.array_equal(voxels.probability, written["probability"])
    assert np.array_equal(np.transpose(voxels.grid.bounds), [written["low"], written["high"]])
    assert voxels.names == tuple(written["class_names"])
    assert np.array_equal(voxels.colors, written["class_colors"])
    predict_panoramas(composed(*given, name="predict_depth"), given)
    ranges = found["ranges"]
    assert np.isfinite(ranges.range_m).any()
    assert np.array_equal(ranges.range_m, np.load("prediction/range.npz")["range_m"], equal_nan=True)


def test_a_rig_at_another_height_moves_the_grid(tmp_path, capsys, composed, monkeypatch):
    images = np.stack(drawn(Rig.load("surround_view"), tmp_path))
    found = omniocc.load("tiny").predict(images, "surround_view")
    assert "the grid lies 1.28 m higher" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    given = ("rig=surround_view", f"images={tmp_path}", "checkpoint=tiny", "overview=false", "mesh=false")
    predict_occupancy(options_of(composed(*given, name="predict_occupancy")))
    written = np.load("occupancy/voxels.npz")
    assert np.array_equal(found.labels, written["labels"])
    assert found.grid.height_m == (written["low"][2], written["high"][2])
    for wrong, message in (
        (images[:3], "3 images for 4 cameras; give one each, of front"),
        (images[:, :, 1:-30], "camera 'front': the image is 289x213 px, but its camera is calibrated for 960x640 px"),
        (images / 255, r"the image is float64 \(213, 320, 3\); give a numpy array"),
        (["a.png"] * 4, r"images are files or a folder; give arrays \(H, W, 3\) uint8"),
        ("my_images", r"images are files or a folder; give arrays \(H, W, 3\) uint8"),
    ):
        with pytest.raises(UserError, match=message):
            omniocc.load("tiny").predict(wrong, "surround_view")


def test_what_a_checkpoint_does_not_hold_is_said_in_one_way():
    trained = omniocc.load("tiny-depth", ["depth.panorama.bottom_deg=-60"])
    assert trained.model.panorama.bottom_deg == -60
    with pytest.raises(UserError, match=r"tiny-depth.*depth stage.*occupancy"):
        trained.task  # noqa: B018 - it is built when it is asked for
    with pytest.raises(UserError, match=r"depth.hints: this has no effect on"):
        omniocc.load("tiny", ["depth.hints=false"]).model  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        omniocc.lod  # noqa: B018
