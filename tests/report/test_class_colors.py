"""Names and colours of classes come from the runs."""

from omniocc.report.runs import FinishedRun, colors_of, names_of


def run(classes, *names):
    return FinishedRun("a-00000000", {"classes": classes}, {f"test/rayiou/{name}": 0.5 for name in names})


def test_recorded_names_keep_their_order_and_colour():
    runs = [run([{"name": "tree", "rgb": [1, 2, 3]}], "tree", "car"), run([], "car", "bus")]
    assert names_of(runs) == ["tree", "car", "bus"]
    colors = colors_of(runs)
    assert colors["tree"] == (1, 2, 3)
    assert len(set(colors.values())) == 3
    assert all(0 <= part <= 255 for color in colors.values() for part in color)


def test_runs_without_classes_have_no_colours():
    assert colors_of([FinishedRun("a-00000000", {}, {})]) == {}
