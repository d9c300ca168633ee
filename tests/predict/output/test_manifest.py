"""A folder never mixes predictions of two models."""

import pytest

from omniocc.errors import UserError
from omniocc.predict.occupancy import places_of
from omniocc.predict.output.manifest import write_manifest
from omniocc.predict.output.voxel_files import VOXELS


def test_force_first_removes_the_predictions_of_the_other_model(tmp_path):
    write_manifest(tmp_path, {"checkpoint": "a"}, force=False)
    prediction = tmp_path / "0000" / VOXELS
    prediction.parent.mkdir()
    prediction.write_bytes(b"of a")
    write_manifest(tmp_path, {"checkpoint": "a"}, force=False)
    with pytest.raises(UserError, match="made with another checkpoint; choose"):
        write_manifest(tmp_path, {"checkpoint": "b"}, force=False)
    assert prediction.exists()
    write_manifest(tmp_path, {"checkpoint": "b"}, force=True)  # a kill may follow at once
    assert not prediction.exists()


def test_what_differs_is_named_without_digests(tmp_path):
    old = {"checkpoint": "0a1b", "rig": "2c3d", "images": "mine", "image_width": 256, "occupied_above": 0.3}
    new = {"checkpoint": "0a1b", "rig": "4e5f", "images": "yours", "image_width": 256, "poses": "6a7b"}
    write_manifest(tmp_path, old, force=False)
    with pytest.raises(UserError) as caught:
        write_manifest(tmp_path, new, force=False)
    assert str(caught.value) == (
        f"{tmp_path} holds predictions made with another rig or road_z_m (theirs: prediction.rig.yaml), "
        "images=mine (now yours), occupied_above=0.3 (now null), other poses; choose another output=..., or force=true "
        "to predict all frames again"
    )


def test_the_same_relative_folder_elsewhere_is_another_place(tmp_path, monkeypatch):
    found = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        found.append(places_of("images"))
    assert found == [str(tmp_path / "a" / "images"), str(tmp_path / "b" / "images")]
    assert places_of(["x.png", "y.png"]) == str([str(tmp_path / "b" / name) for name in ("x.png", "y.png")])
    assert places_of("s3://bucket/images") == "s3://bucket/images"
