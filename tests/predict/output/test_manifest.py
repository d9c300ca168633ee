"""A folder never mixes predictions of two models."""

import pytest

from omniocc.errors import UserError
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
