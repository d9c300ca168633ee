"""Programs of both kinds in one folder are described apart."""

import json
import logging
from types import SimpleNamespace

import pytest
import torch
from torch.nn import functional as F

import omniocc.export.files as files
from omniocc.classes import WORLD_CLASSES
from omniocc.export.files import convolution3d, embedding_bag, without_notices
from omniocc.predict import TrainingData


def test_each_program_has_its_own_description(rig, tmp_path, monkeypatch):
    facts = TrainingData(rig, "fisheye6", -2.2, WORLD_CLASSES, "none", 0.5)
    trained = SimpleNamespace(path=tmp_path / "best.ckpt", occupancy=None, facts=facts)
    instead = {
        "load": lambda _: trained,
        "make_module": lambda *_: None,
        "export_program": lambda _: None,
        "contract_of": lambda *_: {"inputs": []},
        "write_program": lambda program, contract, output: output.write_bytes(b"program"),
    }
    for name, value in instead.items():
        monkeypatch.setattr(files, name, value)
    for name in ("model.pt2", "model.onnx"):
        line = files.export_files("best.ckpt", rig, tmp_path / name)
        assert line.endswith(f"inputs and outputs: {tmp_path / name}.json")
    programs = {path.name: json.loads(path.read_text())["program"] for path in tmp_path.glob("*.json")}
    assert programs == {"model.pt2.json": "model.pt2", "model.onnx.json": "model.onnx"}


@pytest.mark.parametrize(
    "begins", [[0, 2, 5], [0, 0, 3, 7], [0, 4, 8, 8]], ids=["all full", "empty first", "empty last"]
)
def test_embedding_bag(begins):
    torch.manual_seed(0)
    table, weights = torch.randn(6, 4), torch.rand(8)
    rows, offsets = torch.randint(0, 6, (8,), dtype=torch.int32), torch.tensor(begins, dtype=torch.int32)
    expected = F.embedding_bag(rows, table, offsets, mode="sum", per_sample_weights=weights)
    found = embedding_bag(table, rows, offsets, per_sample_weights=weights)[0]
    torch.testing.assert_close(found, expected)


def test_convolution_without_bias():
    torch.manual_seed(0)
    volume, weight = torch.randn(1, 2, 4, 5, 6), torch.randn(3, 2, 3, 3, 3)
    found = convolution3d(volume, weight, None, [1, 1, 1], [1, 0, 1], [1, 1, 1], 1)
    torch.testing.assert_close(found, F.conv3d(volume, weight, padding=(1, 0, 1)))


def test_notices_of_the_exporting_libraries_are_silent_for_the_time_of_the_export(caplog):
    logger = logging.getLogger("onnx_ir")
    with without_notices():
        logger.warning("Attribute type is ambiguous")
        logger.error("this counts")
    logger.warning("afterwards")
    assert [record.message for record in caplog.records] == ["this counts", "afterwards"]
