"""Programs of both kinds in one folder are described apart."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

import omniocc.export.files as files
from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.predict.input.sequence import with_road


def test_each_program_has_its_own_description(rig, tmp_path, monkeypatch):
    trained = SimpleNamespace(width_for=lambda rig: 64, classes=None, road_z_m=-2.2, frame_interval_s=0.5)
    instead = {
        "load_occupancy": lambda path: (None, None), "training_data": lambda *_: trained,
        "make_module": lambda *_: None, "export_program": lambda _: None, "contract_of": lambda *_: {"inputs": []},
        "write_program": lambda program, contract, output: output.write_bytes(b"program"),
    }  # fmt: skip
    for name, value in instead.items():
        monkeypatch.setattr(files, name, value)
    for name in ("model.pt2", "model.onnx"):
        line = files.export_files(files.Options(tmp_path / "best.ckpt", rig, tmp_path / name, None))
        assert line.endswith(f"inputs and outputs: {tmp_path / name}.json")
    programs = {path.name: json.loads(path.read_text())["program"] for path in tmp_path.glob("*.json")}
    assert programs == {"model.pt2.json": "model.pt2", "model.onnx.json": "model.onnx"}


def test_the_origin_lies_as_high_above_the_road_as_in_training(rig, capsys):
    low = Rig.load("surround_view")
    raised, height_m = files.on_road(low, -2.2)
    assert height_m == pytest.approx(-0.916 + 2.2)
    assert raised.road_z_m == pytest.approx(-2.2)
    assert torch.allclose(raised.ego_from_camera[:, 2, 3], low.ego_from_camera[:, 2, 3] - height_m)
    assert "the grid lies 1.28 m higher" in capsys.readouterr().err
    assert files.on_road(with_road(low, -2.2), -2.2)[1] == 0
    assert capsys.readouterr().err == ""
    assert files.on_road(low, None) == (low, 0.0)
    assert "stays around the origin of the rig" in capsys.readouterr().err
    unknown = replace(low, road_z_m=None)
    assert files.on_road(unknown, -2.2) == (unknown, 0.0)
    assert "taken for -2.2 m, as in training" in capsys.readouterr().err
    with pytest.raises(UserError, match="road_z_m"):
        with_road(low, 0.3)
