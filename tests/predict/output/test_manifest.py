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
    with pytest.raises(UserError, match=r"checkpoint.*'a'"):
        write_manifest(tmp_path, {"checkpoint": "b"}, force=False)
    assert prediction.exists()
    write_manifest(tmp_path, {"checkpoint": "b"}, force=True)  # a kill may follow at once
    assert not prediction.exists()
