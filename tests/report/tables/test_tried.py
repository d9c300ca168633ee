import csv
from pathlib import Path

import pytest

from omniocc.config import compose_plain
from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.tables.tried import changes, tried_cells, tried_csv


def run(name, seed, rayiou, config, data="d", **facts):
    known = {"seed": seed, "data": data, "stages": {"depth": 8, "sketch": 5, "occupancy": 10}, "minutes of training": 2}
    return FinishedRun(f"{name}-0123456{seed}", known | facts, {"val/rayiou": rayiou}, config=config)


CONF = Path(__file__).parents[3] / "conf"


@pytest.fixture(scope="module")
def ours():
    return compose_plain(CONF, "train", ["name=ours"])


@pytest.fixture(scope="module")
def more():
    return compose_plain(CONF, "train", ["name=more", "model.lifter.evidence=true"])


def test_a_line_for_each_configuration_with_its_changes_by_falling_score(ours, more):
    runs = [run("ours", 0, 0.2, ours), run("ours", 1, 0.3, ours), run("more", 0, 0.4, more), run("more", 1, 0.6, more)]
    head, lines = tried_cells(runs, "ours")
    assert head[:6] == [
        "row",
        "change",
        "steps of depth, sketch and occupancy",
        "seeds",
        "minutes",
        "validation voxel RayIoU, mean",
    ]
    assert [line[:6] for line in lines] == [
        ["more", "lifter.evidence=true", "8/5/10", "2", "2", "0.5"],
        ["ours", "the reference", "8/5/10", "2", "2", "0.25"],
    ]


def test_equal_runs_of_a_seed_count_once_by_the_name_of_the_reference(ours):
    runs = [run("ours", 0, 0.2, ours), run("demo", 0, 0.2, ours), run("train", 0, 0.2, ours)]
    assert [line[:6] for line in tried_cells(runs, "ours")[1]] == [["ours", "the reference", "8/5/10", "1", "2", "0.2"]]


def test_runs_before_and_after_a_key_that_is_null_are_one_line(ours):
    former = {key: value for key, value in ours.items() if key != "lr_multipliers"}
    assert ours["lr_multipliers"] is None
    (line,) = tried_cells([run("ours", 0, 0.2, ours), run("ours", 1, 0.4, former)], "ours")[1]
    assert line[3] == "2"


def test_other_data_is_a_line_of_its_own(ours):
    lines = tried_cells([run("ours", 0, 0.2, ours), run("ours", 0, 0.3, ours, data="larger")], "ours")[1]
    assert [line[5] for line in lines] == ["0.3", "0.2"]


def test_runs_of_another_preset_are_left_out(ours):
    runs = [run("ours", 0, 0.3, ours, data="large", preset="small")]
    runs += [run("ours", seed, rayiou, ours, preset="tiny") for seed, rayiou in ((0, 0.2), (1, 0.4))]
    assert [line[5] for line in tried_cells(runs, "ours")[1]] == ["0.3"]


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (["model/geometry=cuboid"], "model/geometry=cuboid"),
        (["model/sketch=mono"], "model/depth=mono"),
        (["optimizer=adamw"], "optimizer=AdamW"),
        (["loss.weights.scal=0.5", "seed=3", "preset.channels=32"], "weights.scal=0.5"),
        (["model.sketch.dilation_m=[0,0,0]"], "sketch.dilation_m=[0, 0, 0]"),
    ],
)
def test_changes_name_exchanged_parts_and_new_values_once(overrides, named, ours):
    assert changes(compose_plain(CONF, "train", overrides), ours) == named


def test_changes_name_an_added_part_once_and_a_missing_one_as_none(ours):
    losses = compose_plain(CONF, "train", ["loss=with_first_hits"])
    assert changes(losses, ours) == "first_hit=FirstHit"
    assert changes(ours, losses) == "first_hit=none"


def test_a_setting_that_the_reference_did_not_know_yet_is_no_change(ours):
    newer = ours | {"trainer": ours["trainer"] | {"new_option": 1}}
    assert changes(newer, ours) == changes(ours, newer) == ""


def test_a_missing_reference_is_named(more):
    with pytest.raises(UserError, match="no finished run of row ours"):
        tried_cells([run("more", 0, 0.4, more)], "ours")


def test_columns_are_the_bands_of_the_runs_and_another_protocol_is_left_out(ours, more):
    rays, other = {"protocol": {"rayiou": "one origin"}}, {"protocol": {"rayiou": "eight origins"}}
    figures = {"val/rayiou": 0.2, "test/rayiou_20-40m": 0.1, "test/rayiou_0-20m": 0.3, "val/rayiou_0-20m": 0.25}
    base = run("ours", 0, 0.2, ours, **rays)._replace(metrics=figures)
    text = tried_csv([base, run("more", 0, 0.4, more, **other)], "ours")
    (line,) = csv.DictReader(text.splitlines())
    means = [line[f"validation {title}, mean"] for title in ("voxel RayIoU", "0-20 m", "20-40 m", "surface RayIoU")]
    assert (line["row"], means) == ("ours", ["0.2", "0.25", "", ""])
