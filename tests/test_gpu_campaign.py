"""The measurements for a first GPU, at smoke size on the CPU and on a simulated second device."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from second_device import SecondDevice, tagged

from omniocc.camera import Rig

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

import gpu_campaign as campaign  # noqa: E402

PAIRS = {
    "attention": campaign.attention_pair,
    "sweep": campaign.sweep_pair,
    "splat": campaign.splat_pair,
}


@pytest.fixture
def cfg():
    return campaign.compose_preset("smoke")


def assert_same_there(ours, plain):
    """Compare results and gradients, and where they are."""
    for run in (ours, plain):
        result = run()
        assert tagged(result)
        result.square().mean().backward()
    with torch.no_grad():
        assert float((ours() - plain()).abs().max().cpu()) < 1e-3


@pytest.mark.parametrize("name", PAIRS)
def test_operations_agree_with_their_plain_versions_on_a_second_device(name, cfg):
    rig = Rig.load("fisheye6").resized(64, 36)
    with SecondDevice():
        assert_same_there(*PAIRS[name](cfg, rig, torch.device("cuda", 0)))


@pytest.mark.parametrize("grid", ["cylinder", "cuboid"])
def test_warps_agree_with_their_plain_version_on_a_second_device(grid):
    cfg = campaign.compose_preset("smoke", f"model/geometry={grid}")
    with SecondDevice():
        assert_same_there(*campaign.warp_pair(cfg, torch.device("cuda", 0)))


def run(folder: Path, parts: str) -> subprocess.CompletedProcess:
    environment = {
        "PATH": "/usr/bin:/bin",
        "PYTHON": sys.executable,
        "PYTHONPATH": str(ROOT / "src"),
        "OMP_NUM_THREADS": "1",
        "PRESETS": "smoke",
        "DEVICE": "cpu",
        "REPEATS": "1",
        "PARTS": parts,
    }
    command = ["bash", "tests/bench/gpu_campaign.sh", str(folder)]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=400)


@pytest.mark.whole_runs
def test_parts_are_joined_a_failing_one_is_named_and_a_second_call_measures_only_it(tmp_path):
    result = run(tmp_path, "operations nothing rayiou")
    assert result.returncode == 1, result.stderr
    assert f"failed: {tmp_path}/logs/nothing-smoke.log" in result.stdout
    joined = json.loads((tmp_path / "campaign.json").read_text())
    assert sorted(joined) == ["operations-smoke", "rayiou-smoke"]
    assert len(joined["operations-smoke"]["rows"]) == 8
    for part in joined.values():
        for row in part["rows"]:
            assert all(math.isfinite(value) for value in row.values() if isinstance(value, float)), row
    assert "| warp of a volume, plain |" in (tmp_path / "campaign.md").read_text()
    written = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "parts").iterdir()}
    assert run(tmp_path, "operations slots streaming").returncode == 0
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "parts").iterdir()}
    assert after.items() > written.items()
    assert {"slots-smoke.json", "streaming-smoke.json"} == after.keys() - written.keys()
