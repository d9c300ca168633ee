import pytest

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.tables.tried import changes, tried_cells


def run(name, seed, rayiou, config, data="d", **facts):
    known = {"seed": seed, "data": data, "stages": {"depth": 8, "sketch": 5, "occupancy": 10}, "minutes of training": 2}
    return FinishedRun(f"{name}-0123456{seed}", known | facts, {"val/rayiou": rayiou}, config=config)


OURS = {"name": "ours", "seed": 0, "model": {"lifter": {"evidence": False}, "refiner": {"channels": [16, 32]}}}
MORE = {"name": "more", "seed": 1, "model": {"lifter": {"evidence": True}, "refiner": {"channels": [16, 32]}}}


def test_a_line_for_each_configuration_with_its_changes_by_falling_score():
    runs = [run("ours", 0, 0.2, OURS), run("ours", 1, 0.3, OURS), run("more", 0, 0.4, MORE), run("more", 1, 0.6, MORE)]
    head, lines = tried_cells(runs, "ours")
    assert head[:6] == ["run", "change", "steps", "seeds", "minutes", "RayIoU"]
    assert [line[:6] for line in lines] == [
        ["more", "lifter.evidence=true", "8/5/10", "2", "2", "0.500 ± 0.141"],
        ["ours", "the reference", "8/5/10", "2", "2", "0.250 ± 0.071"],
    ]


def test_other_data_is_a_line_of_its_own():
    lines = tried_cells([run("ours", 0, 0.2, OURS), run("ours", 0, 0.3, OURS, data="larger")], "ours")[1]
    assert [line[5] for line in lines] == ["0.300", "0.200"]


def test_changes_name_new_values_only():
    assert changes({"a.b.c": [1, 2], "a.d": "x"}, {"a.b.c": [1], "gone.e": 1, "a.d": "y"}) == "b.c=[1, 2], a.d=x"


def test_a_missing_reference_is_named():
    with pytest.raises(UserError, match="no finished run of row ours"):
        tried_cells([run("more", 0, 0.4, MORE)], "ours")
