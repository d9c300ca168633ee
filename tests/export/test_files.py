"""Programs of both kinds in one folder are described apart."""

import json
from types import SimpleNamespace

import omniocc.export.files as files
from omniocc.classes import WORLD_CLASSES
from omniocc.predict import TrainingData


def test_each_program_has_its_own_description(rig, tmp_path, monkeypatch):
    facts = TrainingData(rig, "fisheye6", -2.2, WORLD_CLASSES, "none", 0.5)
    trained = SimpleNamespace(path=tmp_path / "best.ckpt", occupancy=None, facts=facts)
    instead = {
        "load": lambda _: trained,
        "make_module": lambda *_: None, "export_program": lambda _: None, "contract_of": lambda *_: {"inputs": []},
        "write_program": lambda program, contract, output: output.write_bytes(b"program"),
    }  # fmt: skip
    for name, value in instead.items():
        monkeypatch.setattr(files, name, value)
    for name in ("model.pt2", "model.onnx"):
        line = files.export_files("best.ckpt", rig, tmp_path / name)
        assert line.endswith(f"inputs and outputs: {tmp_path / name}.json")
    programs = {path.name: json.loads(path.read_text())["program"] for path in tmp_path.glob("*.json")}
    assert programs == {"model.pt2.json": "model.pt2", "model.onnx.json": "model.onnx"}
