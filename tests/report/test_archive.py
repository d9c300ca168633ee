"""A folder of runs as one file. Forged ones are opened by `tests/hostile/forge_archives.py`."""

import json
import lzma
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest
from fake_sweep import report

from omniocc.errors import DataError, UserError
from omniocc.report import archive
from omniocc.report.archive import archive_of, files_of, folder_of, read_archive
from omniocc.report.keep import keep_records
from omniocc.report.runs import read_runs
from omniocc.runs.results import FINISHED, utc_text

NAMES = ("ours-00000001", "ours-00000002", "dense-00000001", "cuboid-00000001")


@pytest.fixture
def kept(runs, tmp_path) -> Path:
    """Return an archive of finished runs, beside a folder of the same, `kept`."""
    for name in NAMES:
        shutil.copytree(runs / name, tmp_path / "runs" / name)
    keep_records(tmp_path / "runs", tmp_path / "kept")
    report("--runs", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.tar.xz"))
    return tmp_path / "runs.tar.xz"


def files_below(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_an_archive_has_what_a_folder_would_have_and_other_programs_read_it(kept, tmp_path):
    assert read_archive(kept) == files_below(tmp_path / "kept")
    (tmp_path / "by tar").mkdir()
    subprocess.run(["tar", "-xJf", str(kept), "-C", str(tmp_path / "by tar")], check=True)
    assert files_below(tmp_path / "by tar") == files_below(tmp_path / "kept")
    with tarfile.open(kept) as members:
        assert {(member.mtime, member.uid, member.gid, member.mode) for member in members} == {(0, 0, 0, 0o644)}


def test_equal_files_give_equal_bytes_in_whatever_order_they_come():
    files = {"b/config.yaml": b"b: 1", "a/metrics.json": b"{}" * 600, "a/config.yaml": b"", "ä/csv/x.csv": b"\0" * 512}
    first = archive_of(files)
    assert archive_of(dict(reversed(files.items()))) == first
    assert files_of(first) == files
    assert list(files_of(first)) == ["a/config.yaml", "b/config.yaml", "a/metrics.json", "ä/csv/x.csv"]


def test_the_report_of_an_archive_is_that_of_its_folder_without_links_to_runs(kept, tmp_path):
    report("--runs", str(kept), "--docs", str(tmp_path / "docs"))
    report("--runs", str(tmp_path / "kept"), "--docs", str(tmp_path / "docs2"), "--output", str(tmp_path / "report2"))
    assert files_below(tmp_path / "docs") == files_below(tmp_path / "docs2")
    ours, theirs = files_below(tmp_path / "report"), files_below(tmp_path / "report2")
    assert ours.keys() == theirs.keys()
    assert {name for name in ours if ours[name] != theirs[name]} == {"report.md", "index.html"}
    tables, _, listed = ours["report.md"].decode().partition("## Runs")
    assert tables == theirs["report.md"].decode().partition("## Runs")[0]
    assert "- ours-00000001: `python src/train.py" in listed
    page = ours["index.html"].decode()
    assert "<td>ours-00000001</td>" in page
    assert "ours-00000001/" not in page
    assert 'ours-00000001/config.yaml">' in theirs["index.html"].decode()


def test_keeping_the_same_runs_again_changes_nothing(kept, tmp_path, monkeypatch):
    before = kept.read_bytes()
    monkeypatch.setattr(archive, "archive_of", lambda files: pytest.fail("it is written again"))
    report("--runs", str(tmp_path / "runs"), "--keep", str(kept))
    monkeypatch.undo()
    assert kept.read_bytes() == before
    report("--runs", str(kept), "--keep", str(tmp_path / "again.tar.xz"))
    assert (tmp_path / "again.tar.xz").read_bytes() == before


def test_a_newer_run_replaces_that_of_its_row_and_seed_in_an_archive(kept, runs, tmp_path):
    newer = shutil.copytree(runs / "ours-00000001", tmp_path / "later" / "ours-0000000a") / "metrics.json"
    newer.write_text(json.dumps(json.loads(newer.read_text()) | {FINISHED: utc_text(4e9)}))
    report("--runs", str(tmp_path / "later"), "--keep", str(kept))
    assert {name.partition("/")[0] for name in read_archive(kept)} == {*NAMES[1:], "ours-0000000a"}


def test_a_damaged_run_of_an_archive_is_named_and_left_out(kept, capsys):
    files = read_archive(kept)
    kept.write_bytes(archive_of(files | {"ours-00000001/metrics.json": files["ours-00000001/metrics.json"][:60]}))
    with folder_of(kept) as folder:
        found = read_runs(folder)
    assert {run.name for run in found} == set(NAMES[1:])
    assert "/runs.tar.xz/ours-00000001/metrics.json is damaged" in capsys.readouterr().err
    assert not folder.parent.exists()


def test_a_run_whose_name_cannot_be_in_an_archive_leaves_it_as_it_is(kept, runs):
    before = kept.read_bytes()
    with pytest.raises(SystemExit) as caught:
        report("--runs", str(runs), "--keep", str(kept))
    text = str(caught.value.code)
    assert text.startswith(f"{kept} cannot hold these runs: the member 'my <own>-00000001/")
    assert "\n" not in text
    assert kept.read_bytes() == before


@pytest.mark.parametrize("name", ["../a", "/a", "a/../../b", "a//b", ".a", "a/.", "a\\b", "a\nb", ""])
def test_a_name_that_could_lead_elsewhere_is_neither_written_nor_read(name, tmp_path):
    with pytest.raises(ValueError, match="has no plain relative name"):
        archive_of({name: b""})
    path = tmp_path / "runs.tar.xz"
    path.write_bytes(lzma.compress(tarfile.TarInfo(name).tobuf(tarfile.USTAR_FORMAT) + bytes(1024)))
    with (
        pytest.raises(DataError, match=r"runs\.tar\.xz is no sound archive of runs: .*no plain relative name"),
        folder_of(path),
    ):
        pass


def test_archives_are_bounded(monkeypatch):
    whole = archive_of({f"a/{number}.csv": bytes(1000) for number in range(9)})
    monkeypatch.setattr(archive, "MOST_FILES", 8)
    with pytest.raises(ValueError, match="more than 8 files"):
        files_of(whole)
    monkeypatch.setattr(archive, "MOST_FILES", 9)
    assert len(files_of(whole)) == 9
    monkeypatch.setattr(archive, "MOST_BYTES", 1 << 13)
    with pytest.raises(ValueError, match="unpacks to more than 0 MiB"):
        files_of(whole)
    with pytest.raises(ValueError, match="would unpack to more than"):
        archive_of({f"a/{number}.csv": bytes(1000) for number in range(9)})


def test_a_missing_archive_is_named(tmp_path):
    with pytest.raises(DataError, match=r"runs\.tar\.xz: the file is missing"), folder_of(tmp_path / "runs.tar.xz"):
        pass
    with (
        pytest.raises(UserError, match="holds no finished run"),
        folder_of(tmp_path / "runs.tar.xz", to_change=True) as folder,
    ):
        keep_records(tmp_path, folder)
    assert not (tmp_path / "runs.tar.xz").exists()
