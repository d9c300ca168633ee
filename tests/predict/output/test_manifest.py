"""Answers of two models never stand in one folder."""

import pytest

from omniocc.errors import UserError
from omniocc.predict.output.claim import claim
from omniocc.predict.output.voxel_files import VOXELS


def test_a_forced_folder_loses_the_answers_of_the_other_model_at_once(tmp_path):
    claim(tmp_path, {"checkpoint": "a"}, force=False)
    answer = tmp_path / "0000" / VOXELS
    answer.parent.mkdir()
    answer.write_bytes(b"of a")
    claim(tmp_path, {"checkpoint": "a"}, force=False)
    with pytest.raises(UserError, match=r"otherwise.*checkpoint.*'a'"):
        claim(tmp_path, {"checkpoint": "b"}, force=False)
    assert answer.exists()
    claim(tmp_path, {"checkpoint": "b"}, force=True)  # a kill may come right after
    assert not answer.exists()
