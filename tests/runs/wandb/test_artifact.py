"""A file that is kept for W&B, without a server."""

from offline_file import records

from omniocc.runs.wandb.artifact import log_file


def test_a_file_is_kept_as_an_artifact(tmp_path):
    folder, file = tmp_path / "ours 1", tmp_path / "view.rrd"
    folder.mkdir()
    file.write_bytes(b"content")
    log_file(folder, file, "streets")
    (found,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    artifacts = [record.artifact for record in records(found) if record.HasField("artifact")]
    assert [(one.name, one.type) for one in artifacts] == [("ours-1-view.rrd", "view")]
    assert [entry.path for entry in artifacts[0].manifest.contents] == ["view.rrd"]
