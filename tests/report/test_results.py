"""The pages of results are made of the kept records alone, and are up to date."""

import shutil
from pathlib import Path

import pytest

from omniocc.report.chapters import write_docs
from omniocc.report.runs import read_runs
from omniocc.report.sweep import read_sweeps

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
GENERATED = {
    page.name: page.read_bytes() for page in RESULTS.glob("*.md") if page.read_text().startswith("<!-- Written")
}


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, bytes]:
    """Return the pages of copied records, whose files have other times and lie elsewhere."""
    folder = tmp_path_factory.mktemp("records")
    for path in sorted((RESULTS / "runs").iterdir(), reverse=True):
        shutil.copytree(path, folder / path.name, copy_function=shutil.copyfile)
    sweeps = read_sweeps(folder, ROOT / "sweeps", ROOT / "conf", None)
    return {page.name: page.read_bytes() for page in write_docs(sweeps, folder / "docs")}


def test_every_generated_page_is_written_again_bit_for_bit(written):
    """`python src/report.py --runs docs/results/runs --docs docs/results` changes nothing."""
    assert len(GENERATED) > 10
    assert sorted(written) == sorted(GENERATED)
    assert [name for name, page in GENERATED.items() if written[name] != page] == []


def test_every_kept_run_is_in_the_list_of_runs(written):
    records = written["runs.md"].decode()
    assert [run.name for run in read_runs(RESULTS / "runs") if f"| {run.name} |" not in records] == []
