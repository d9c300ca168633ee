"""Programs of both kinds in one folder are described apart."""

import json
import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from torch.nn import functional as F

import omniocc.export.files as files
from omniocc.camera import Rig
from omniocc.classes import UNKNOWN, WORLD_CLASSES
from omniocc.export.files import convolution3d, embedding_bag, without_notices
from omniocc.geometry import Cylinder
from omniocc.predict import TrainingData, load


def test_each_program_has_its_own_description(rig, tmp_path, monkeypatch):
    facts = TrainingData(rig, "fisheye6", -2.2, WORLD_CLASSES, "none", 0.5)
    model = SimpleNamespace(geometry=Cylinder((8, 10, 4)))
    trained = SimpleNamespace(path=tmp_path / "best.ckpt", occupancy=model, facts=facts, occupied_above=None)
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
        described = json.loads((tmp_path / f"{name}.json").read_text())
        assert 0.5 < np.load(tmp_path / described["seen"]).mean() < 1
    programs = {path.name: json.loads(path.read_text())["program"] for path in tmp_path.glob("*.json")}
    assert programs == {"model.pt2.json": "model.pt2", "model.onnx.json": "model.onnx"}


@pytest.mark.whole_runs
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Sparse CSR", "ignore:No complete tensor found")
def test_a_rig_at_another_height_has_the_voxels_of_predict(tmp_path, capsys):
    """The road of `surround_view` is .916 m below its origin; `any-rig` has a threshold."""
    rig, trained, output = Rig.load("surround_view"), load("any-rig"), tmp_path / "model.pt2"
    files.export_files("any-rig", rig, output)
    assert "the grid lies 1.28 m higher" in capsys.readouterr().err
    described = json.loads((tmp_path / "model.pt2.json").read_text())
    width, height = described["rig"]["image_size_px"]
    patches = np.random.default_rng(0).integers(0, 255, (len(rig.names), 10, 15, 3), dtype=np.uint8)
    images = patches.repeat(16, 1).repeat(16, 2)[:, :height, :width]
    expected = trained.predict(images, rig)
    program = torch.export.load(output).module()
    labels = program(torch.from_numpy(images).permute(0, 3, 1, 2))
    seen = np.load(tmp_path / described["seen"])
    assert np.array_equal(np.where(seen, labels.numpy(), UNKNOWN), expected.labels)
    assert len(np.unique(expected.labels)) > 3
    assert not seen.all()
    assert described["grid"]["bounds_in_rig_file"] == [list(ends) for ends in expected.grid.bounds]
    assert described["occupied_above"] == trained.occupied_above == 0.2
    likeliest = replace(trained, config=OmegaConf.merge(trained.config, {"occupied_above": None}))
    assert not np.array_equal(likeliest.predict(images, rig).labels, expected.labels)


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
