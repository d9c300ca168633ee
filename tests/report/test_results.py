"""The pages of results and the CSV beside them are made of the kept records alone, and are up to date."""

import csv
from pathlib import Path

import pytest

from omniocc.report.archive import folder_of, read_archive
from omniocc.report.docs import write_docs
from omniocc.report.sweep import read_sweeps

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
RECORDS = RESULTS / "runs.tar.xz"
PAGES = [path for path in RESULTS.rglob("*.md") if path.read_text().startswith("<!-- Written")]
GENERATED = {str(path.relative_to(RESULTS)): path.read_bytes() for path in [*PAGES, *(RESULTS / "csv").iterdir()]}


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> dict[str, bytes]:
    docs = tmp_path_factory.mktemp("docs")
    with folder_of(RECORDS) as folder:
        files = write_docs(read_sweeps(folder, ROOT / "sweeps", ROOT / "conf", None), docs)
    return {str(path.relative_to(docs)): path.read_bytes() for path in files}


@pytest.mark.whole_runs
def test_every_generated_file_is_written_again_bit_for_bit(written):
    """`python src/report.py --runs docs/results/runs.tar.xz --docs docs/results` changes nothing."""
    assert len(PAGES) == 8
    assert sorted(written) == sorted(GENERATED)
    assert [name for name, page in GENERATED.items() if written[name] != page] == []


@pytest.mark.whole_runs
def test_every_kept_run_is_in_the_list_of_runs(written):
    lines = csv.DictReader(written["csv/runs.csv"].decode().splitlines())
    kept = [name.split("/") for name in read_archive(RECORDS)]
    assert {line["run"] for line in lines} == {run for run, *file in kept if file == ["metrics.json"]}


def test_the_records_are_small():
    assert RECORDS.stat().st_size <= 3_000_000


@pytest.mark.whole_runs
def test_no_column_has_an_empty_head_and_text_stands_to_the_left(written):
    """In the tables of pages a column to the right has no letters but those of a unit or of two numbers."""
    tables = 0
    for name in (name for name in written if name.endswith(".md")):
        lines = [line.strip("| ").split(" | ") for line in written[name].decode().splitlines() if line.startswith("|")]
        for place in (place for place, line in enumerate(lines) if set("".join(line)) <= set("-:")):
            head, align, first = lines[place - 1 : place + 2]
            assert all(head), (name, head)
            right = [cell for cell, side in zip(first, align, strict=True) if side.endswith(":")]
            assert not any(cell.strip("0123456789.,+-±–%✅☑❌❓=()</>* Mkand") for cell in right), (name, right)
            tables += 1
    assert tables > 20
