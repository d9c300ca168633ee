"""`src/view.py` as users start it: what it refuses, in a line, and what it writes."""

import pytest
from scripts import run_script

from omniocc.errors import UserError
from omniocc.extras.viewer.options import options_of


@pytest.fixture
def options(composed):
    return lambda *overrides: options_of(composed(*overrides, name="view"))


def test_one_run_or_several(options):
    assert options("run=tiny")[0].run == ["tiny"]
    assert options("run=[a,b]")[0].run == ["a", "b"]
    shown, target = options("run=tiny", "frames=[1,2]", "scene=x", "limit=null", "save=v.rrd")
    assert (shown.frames, shown.scene, shown.limit, target.save) == ([1, 2], "x", None, "v.rrd")
    assert options("watch=runs")[0] is None
    assert options("watch=runs", "port=0")[1].port == 0


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ((), "nothing to show: give run="),
        (("run=tiny", "predictions=x"), "predictions=... are shown as they are"),
        (("run=tiny", "save=v.rrd", "connect=h"), "save=... and connect=... are different places"),
        (("run=tiny", "page=true", "save=v.rrd"), "save=... and page=... are different places"),
        (("run=tiny", "watch=runs"), "watch=runs follows runs in progress: leave run out"),
        (("watch=runs", "limit=3", "scene=x"), "leave scene, limit out"),
        (("watch=runs", "page=true"), "page=... and watch=... are different places"),
        (("run=tiny", "save=."), "save=. is a folder"),
        (("watch=runs", "port=70000"), "port=70000"),
        (("run=tiny", "limit=0"), "limit=0"),
        (("run=tiny", "limit=few"), "limit: 'few' is not"),
        (("run=tiny", "frames=3"), "frames: 3 is not"),
        (("run=3",), "run: "),
        (("run=tiny", "wandb=true"), "wandb=true keeps a file"),
        (("run=tiny", "wandb=true", "save=v.rrd"), "wandb=true keeps the file with a run"),
        (("run=tiny", "output=x.html"), "output=x.html is the file of a page: give page=true too"),
    ],
)
def test_impossible_options_are_a_line(options, overrides, words):
    with pytest.raises(UserError) as caught:
        options(*overrides)
    assert words in str(caught.value)


@pytest.mark.slow
def test_the_command(cylinder_run, tmp_path):
    done = run_script("view.py", f"run={cylinder_run}", "save=v.rrd", "limit=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"loading {cylinder_run}\n")
    assert "2 frames" in done.stdout
    assert "open it by: rerun v.rrd" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["v.rrd"]
    without = run_script("view.py", "run=tiny", "sav=v.rrd", cwd=tmp_path)
    assert without.returncode == 1
    assert "save" in without.stderr
    assert "Traceback" not in without.stderr
