"""`src/view.py page=true` as users start it."""

import json

import pytest
from made_scenes import SCENES
from scripts import run_script

from omniocc.runs.folder import PAGE


def facts_of(page) -> dict:
    return json.loads(page.read_text("utf-8").split('id="facts">', 1)[1].split("</script>", 1)[0])


@pytest.mark.whole_runs
@pytest.mark.slow
def test_a_run_and_scenes_without_a_model(make_run, dataset, tmp_path):
    run = make_run("ours-9d8e7f6a")
    done = run_script("view.py", f"run={run}", "page=true", "limit=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == (run / PAGE).as_uri()
    facts = facts_of(run / PAGE)
    assert facts["runs"] == [run.name]
    assert len(facts["frames"]) == 2
    for frame in facts["frames"]:
        assert set(frame["predictions"][0]["figures"]) >= {"rayiou", "iou", "miou"}
        assert list(frame["truth"]) == ["0"]

    done = run_script("view.py", f"recorded={dataset}", f"scene={SCENES[0]}", "page=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = facts_of(tmp_path / PAGE)
    assert facts["runs"] == []
    assert {frame["scene"] for frame in facts["frames"]} == {SCENES[0]}
    assert [path.name for path in tmp_path.iterdir()] == [PAGE]
