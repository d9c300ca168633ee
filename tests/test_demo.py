"""What the demo runs and shows, with and without weights in the package."""

from pathlib import Path

import demo
import pytest
import torch
from omegaconf import OmegaConf

from omniocc.config import check_root, compose_plain
from omniocc.runs.results import EARLIER_MINUTES, MINUTES, save_results
from omniocc.runs.table import BASELINE, BOUND
from omniocc.runs.weights import pack_weights

ROOT = Path(__file__).parents[1]

SCORES = ("rayiou", "rayiou_0-8.5m", "lidar/rayiou", "voxel/iou", "voxel/miou")
METRICS = {f"{row}/{key}": 0.5 for row in ("test", "prior", "label") for key in SCORES}


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """Weights of the name that the demo looks for."""
    folder = tmp_path / "weights"
    monkeypatch.setattr("omniocc.runs.weights.SHIPPED", folder)
    monkeypatch.setattr(demo, "SHIPPED", folder)
    pack_weights(
        folder / "tiny.safetensors", "occupancy", {}, {"a": torch.ones(2)}, {MINUTES: 200, EARLIER_MINUTES: 40}
    )


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """The scripts that the demo starts, each of which writes results at once."""
    calls, root = [], tmp_path / "root"
    monkeypatch.setattr(demo, "ROOT", root)
    monkeypatch.setattr(demo, "folder_of", lambda recipe, runs: (runs / "demo-1", "best.ckpt"))

    def run(script, arguments):
        calls.append([script, *arguments])
        if script == "view.py":
            (root / "runs" / "demo-1" / "view.html").touch()
            return
        folder = root / "runs" / "demo-1" if script == "train.py" else Path(arguments[-1])
        folder.mkdir(parents=True)
        save_results(folder, METRICS, {MINUTES: 3.2, EARLIER_MINUTES: 0.0})

    monkeypatch.setattr(demo, "run", run)
    return calls


def test_without_weights_every_stage_is_trained(ran, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("omniocc.runs.weights.SHIPPED", tmp_path / "none")
    demo.main("tiny", full=False)
    folder = tmp_path / "root" / "runs" / "demo-1"
    view = ["view.py", f"run={folder}", "page=true", "limit=8", f"output={folder}/view.html"]
    assert ran == [["train.py", "name=demo", "model=extended", "preset=tiny"], view]
    lines = capsys.readouterr().out.strip().splitlines()
    assert [line.split("  ")[0] for line in lines[1:4]] == [
        BASELINE,
        "trained here, 3 min",
        BOUND,
    ]
    assert lines[-2] == "images    runs/demo-1/images"
    assert lines[-1].startswith("page      runs/demo-1/view.html")
    demo.viewed(folder)
    assert len(ran) == 2  # written before


def test_with_weights_only_occupancy_is_trained_and_they_stand_beside_it(weights, ran, capsys):
    demo.main("tiny", full=False)
    (train, evaluate, _) = ran
    assert train[-1] == "+demo=quick"
    assert evaluate[:2] == ["evaluate.py", "tiny"]
    quick = OmegaConf.create(compose_plain(ROOT / "conf", "train", train[1:]))
    assert f"data.source.test_scenes={quick.data.source.test_scenes}" in evaluate
    out = capsys.readouterr().out
    assert "weights 'tiny' in the package, 4 h" in out
    assert (demo.ROOT / "runs" / "demo-1" / demo.TABLE).read_text().count("\n") == 6
    demo.evaluated(demo.ROOT / "runs" / "demo-1", train[1:])
    assert len(ran) == 3  # finished before


@pytest.mark.parametrize(("preset", "full"), [("tiny", True), ("smoke", False)])
def test_everything_is_trained_on_demand_and_for_other_presets(preset, full, weights):
    assert "+demo=quick" not in demo.overrides_of(preset, full)


def test_the_quick_demo_is_a_configuration_that_trains():
    config = compose_plain(ROOT / "conf", "train", ["model=extended", "preset=tiny", "+demo=quick"])
    check_root(OmegaConf.create(config))
    assert config["stages"]["depth"]["weights"] == "tiny"
    assert config["stages"]["sketch"]["max_steps"] == 0
