"""Training from an S3 server, whose connection is cut for some seconds."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from store import KEYS, Proxy, can_start, s3_server

from omniocc.runs.results import METRICS

pytestmark = pytest.mark.cluster
ROOT = Path(__file__).parents[2]
BUCKET = "scenes"


def run(script: str, *overrides: str, folder: Path, port: int | None = None) -> tuple[int, str]:
    """Return exit code and output of one of the scripts; S3 is at `port`."""
    endpoint = {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}"} if port else {}
    found = subprocess.run(
        [sys.executable, str(ROOT / "src" / script), "preset=smoke", *overrides],
        cwd=folder,
        env={**os.environ, **KEYS, **endpoint},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=500,
        check=False,
    )
    return found.returncode, found.stdout


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[int]:
    """Return the port of an S3 server that has the scenes of preset=smoke in a bucket."""
    if not can_start():
        pytest.skip("the S3 server moto is not installed and cannot be: uv tool run finds no package index")
    folder = tmp_path_factory.mktemp("s3")
    code, said = run("render.py", f"data.source.root={folder}/data", folder=folder)
    assert code == 0, said
    with s3_server(folder) as port:
        upload(folder / "data", port)
        yield port


def upload(folder: Path, port: int) -> None:
    import s3fs

    place = f"http://127.0.0.1:{port}"
    store = s3fs.S3FileSystem(key="key", secret="secret", endpoint_url=place, skip_instance_cache=True)
    store.mkdir(BUCKET)
    store.put(str(folder), f"{BUCKET}/data", recursive=True)


def train(folder: Path, port: int, steps: int = 6) -> tuple[str, dict[str, float]]:
    """Train from the bucket, with a cache of its own; return what was said, and the scores."""
    code, said = run(
        "train.py",
        f"data.source.root=s3://{BUCKET}/data",
        f"data.source.cache={folder}/cache",
        "model=extended",
        f"preset.stages.occupancy.max_steps={steps}",
        "logger.mode=disabled",
        "test_images=0",
        folder=folder,
        port=port,
    )
    assert code == 0, said
    (path,) = folder.glob(f"runs/train-*/{METRICS}")
    scores = json.loads(path.read_text())
    return said, {key: value for key, value in scores["metrics"].items() if "second" not in key}


@pytest.fixture(scope="module")
def undisturbed(server, tmp_path_factory) -> tuple[int, dict[str, float]]:
    """Return the bytes that a training reads, and its scores."""
    proxy = Proxy(server)
    _, scores = train(tmp_path_factory.mktemp("undisturbed"), proxy.port)
    return proxy.passed, scores


@pytest.mark.parametrize("cut_s", [5, 60])
def test_training_outlives_a_cut_connection(cut_s, server, undisturbed, tmp_path):
    passed, scores = undisturbed
    proxy = Proxy(server, cut_after=passed // 2, cut_s=cut_s)
    said, found = train(tmp_path, proxy.port)
    assert proxy.cuts == 1
    assert found == scores
    assert "Traceback" not in said
    if cut_s > 30:  # a short one may end within the store's own attempts
        assert "no answer (" in said
        assert "answers again after" in said


def test_a_wrong_bucket_and_a_dead_server_are_one_line_each(server, tmp_path):
    code, said = run(
        "train.py", "data.source.root=s3://elsewhere/data", "data.source.cache=cache", folder=tmp_path, port=server
    )
    assert code != 0
    assert "s3://elsewhere/data" in said
    assert "Traceback" not in said
    code, said = run(
        "train.py", f"data.source.root=s3://{BUCKET}/data", "data.source.cache=cache", folder=tmp_path, port=9
    )
    assert code != 0
    assert "Traceback" not in said
    assert len(said.splitlines()) < 6
