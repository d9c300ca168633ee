"""Checkpoints as files."""

import pytest
import torch
from omniocc.task.checkpoint import load_config

from omniocc.errors import UserError


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_a_truncated_checkpoint_is_named(share, tmp_path):
    path = tmp_path / "best.ckpt"
    torch.save({"config": {"seed": 1}, "state_dict": {f"model.{k}": torch.rand(100) for k in range(20)}}, path)
    assert load_config(path)[0]["seed"] == 1
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(UserError, match=r"best\.ckpt.*damaged.*remove"):
        load_config(path)


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "weights.pt"
    torch.save({"weights": torch.rand(3)}, path)
    with pytest.raises(UserError, match=r"weights\.pt.*checkpoint"):
        load_config(path)
    with pytest.raises(FileNotFoundError, match="there is no such checkpoint"):
        load_config(tmp_path / "none.ckpt")
