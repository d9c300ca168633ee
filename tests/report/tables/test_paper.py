"""Tables of the paper beside ours."""

import csv
import math
from pathlib import Path

import pytest

from omniocc.classes import CLASSES, FREE
from omniocc.errors import UserError
from omniocc.report.runs import VOXELS, FinishedRun
from omniocc.report.selection import by_row, comparable, settings_of
from omniocc.report.tables.claims import pairs_of
from omniocc.report.tables.names import method_names
from omniocc.report.tables.paper import (
    PAGES,
    as_csv,
    as_latex,
    figure_of,
    is_table,
    load_table,
    table_cells,
)
from omniocc.runs.rows import known_rows

SWEEPS = Path(__file__).parents[3] / "sweeps"
TABLES = [path for path in sorted(SWEEPS.glob("*.yaml")) if is_table(path)]


def run(name: str, seed: int, value: float, preset: str = "tiny") -> FinishedRun:
    return FinishedRun(name, {"seed": seed, "steps": 9, "preset": preset, "data": "d"}, {"test/rayiou": value})


RUNS = {
    "ours": [run("ours-01234567", 0, 0.2), run("ours-01234568", 1, 0.4)],
    "mono": [run("mono-01234567", 0, 0.1)],
    "dense": [run("dense-01234567", 0, 0.35)],
}


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_every_table_has_our_row_and_figures_in_0_to_1(path):
    table = load_table(path)
    rows = {row.run.partition("@")[0] for row in table.rows}
    assert rows & {"ours", "ours_01s", "cylinder"}
    fractions = [value for row in table.rows for key, value in row.paper.items() if key != VOXELS and value is not None]
    assert all(0 <= value <= 1 for value in fractions)
    assert (table.page == "paper") == (table.number > 0)
    assert table.page in PAGES
    assert rows <= known_rows(SWEEPS.parent / "conf", TABLES).keys()


def test_the_papers_class_figures_have_its_mean_but_for_bevdet():
    table = load_table(SWEEPS / "comparison.yaml")
    names = [f"test/rayiou/{c.name}" for c in CLASSES if c.id != FREE]
    assert list(table.columns) == [VOXELS, "test/rayiou", *names, "test/lidar/rayiou"]
    for row in table.rows:
        _, first, *classes, lidar = row.paper.values()
        assert lidar is None
        if first is None:
            continue
        gap = abs(first - sum(classes) / len(classes))
        assert gap == pytest.approx(0.0275, abs=1e-3) if row.run == "bevdet" else gap < 1e-3


def test_mean_spread_and_number_of_seeds():
    figure = figure_of(RUNS["ours"], "test/rayiou")
    assert figure.mean == pytest.approx(0.3)
    assert figure.std == pytest.approx(math.sqrt(0.02))
    assert figure.error == pytest.approx(0.1)
    assert figure.seeds == 2
    assert figure_of(RUNS["ours"], "test/absent") is None
    assert math.isnan(figure_of(RUNS["mono"], "test/rayiou").std)


def test_seeds_without_a_figure_do_not_count():
    figure = figure_of([run("ours", seed, value) for seed, value in enumerate((0.2, math.nan, 0.4))], "test/rayiou")
    assert (figure.mean, figure.seeds) == (pytest.approx(0.3), 2)


SKETCH = load_table(SWEEPS / "sketch.yaml")


def test_the_papers_figure_stands_beside_ours():
    head, lines = table_cells(SKETCH, RUNS)
    score, surface = SKETCH.columns["test/rayiou"], SKETCH.columns["test/lidar/rayiou"]
    assert head[:4] == ["Method", f"{score}, paper", f"{score}, here", surface]
    assert head[-1] == "Seeds"
    found = {row.run: [line[1], line[2], line[-1]] for row, line in zip(SKETCH.rows, lines, strict=True)}
    assert found["ours"] == ["0.470", "0.300 ± 0.100", "2"]
    assert found["random"] == ["0.401", "–", "0"]
    assert table_cells(SKETCH, RUNS, errors=False)[1][0][2] == "0.300"


def test_a_wide_table_has_a_line_for_each_column():
    table = load_table(SWEEPS / "comparison.yaml")
    head, lines = table_cells(table, RUNS)
    assert head[0] == "Metric"
    assert head[-3:] == ["OmniDepth-Occ, paper", "OmniDepth-Occ, here", "VoxFormer, fisheye, here"]
    found = {line[0]: line[-3:-1] for line in lines}
    assert list(found) == [*table.columns.values(), "Seeds"]
    assert found[table.columns["test/rayiou"]] == ["0.470", "0.300 ± 0.100"]
    assert found["Seeds"] == ["–", "2"]


def test_rows_are_called_by_the_papers_titles_and_told_apart():
    tables = [load_table(SWEEPS / f"{name}.yaml") for name in ("equal_budget", "comparison")]
    names = method_names(tables)
    assert (names["ours"], names["bevformer"]) == ("OmniDepth-Occ", "BEVFormer")
    assert names["bevformer_budget"] == "BEVFormer (bevformer_budget)"


def test_csv_and_latex_hold_the_same_figures():
    longer = {"ours": [found._replace(facts={**found.facts, "steps": 90}) for found in RUNS["ours"][:1]]}
    lines = list(csv.DictReader(as_csv([(SKETCH, RUNS), (SKETCH, longer)]).splitlines()))
    of_ours = [line for line in lines if line["row"] == "ours" and line["key"] == "test/rayiou"]
    assert [line["steps"] for line in of_ours] == ["9", "90"]
    ours = of_ours[0]
    assert (ours["paper"], ours["mean"], ours["seeds"]) == ("0.47", "0.3", "2")
    assert (ours["standard deviation"], ours["standard error"]) == ("0.141421", "0.1")
    assert (of_ours[1]["mean"], of_ours[1]["standard error"]) == ("0.2", "")
    random = next(line for line in lines if line["row"] == "random")
    assert (random["paper"], random["mean"], random["seeds"]) == ("0.401", "", "0")
    latex = as_latex(SKETCH, RUNS)
    assert r"& 0.470 & 0.300 $\pm$ 0.100 &" in latex
    assert latex.count(r"\\") == 1 + len(SKETCH.rows)


def test_a_broken_table_is_named(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("title: x\norder_by: a\ncolumns: {a: A, b: B}\nrows: {ours: {title: o, paper: [0.1]}}\n")
    with pytest.raises(UserError, match=r"bad\.yaml.*ours.* 1 figure.* 2 columns"):
        load_table(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("order_by: b", "order_by is b, which is no column"),
        ("order_by: a\npage: gone", "page is gone; it is one of paper, systems, beyond, appendix/breakdowns"),
        ("order_by: a\ncompares: all", "compares is all; it is one of parts, grids, systems"),
        ("order_by: a\nclaims: [[mono, ours]]", "claims has mono over ours, which is not so in the paper's a"),
        ("order_by: a\nclaims: [[ours, gone]]", "claims has ours over gone, but the table has no row gone"),
        ("order_by: a\nclaims: [[ours, ours]]", "claims has ours over ours, which is not so"),
        ("order_by: a\nclaims: [ours]", "is not a table of the paper"),
    ],
)
def test_impossible_values_of_a_table_are_named(tmp_path, line, message):
    path = tmp_path / "bad.yaml"
    rows = "rows: {ours: {title: o, paper: [0.2]}, mono: {title: m, paper: [0.1]}}"
    path.write_text(f"title: x\n{line}\ncolumns: {{a: A}}\n{rows}\n")
    with pytest.raises(UserError, match=rf"bad\.yaml.*{message}"):
        load_table(path)


def test_only_runs_of_one_setting_are_compared():
    runs = [*RUNS["ours"], run("big-01234567", 0, 0.9, preset="small")]
    first, second = settings_of(runs, None)
    kept, text = comparable(runs, first)
    assert [r.name for r in kept] == ["ours-01234567", "ours-01234568"]
    assert "Of another preset, number of steps or dataset: big-01234567" in text
    assert [r.name for r in comparable(runs, second)[0]] == ["big-01234567"]
    assert settings_of(runs, "small") == [second]
    with pytest.raises(UserError, match=r"paper.*small, tiny"):
        settings_of(runs, "paper")


def test_two_runs_of_a_row_with_one_seed_are_an_error():
    assert list(by_row(RUNS["ours"])) == ["ours"]
    with pytest.raises(UserError, match=r"ours.* 2 runs.*seed 0"):
        by_row([*RUNS["ours"], run("ours-0123456a-2", 0, 0.5)])


def test_an_added_table_needs_no_figures_of_the_paper(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(
        "title: x\norder_by: test/rayiou\ncolumns: {test/rayiou: R}\nrows: {ours: {title: o}, mono: {title: m}}\n"
    )
    table = load_table(path)
    assert table_cells(table, RUNS) == (["Method", "R", "Seeds"], [["o", "0.300 ± 0.100", "2"], ["m", "0.100", "1"]])
    assert table.page == ""
    assert list(pairs_of(table)) == []


def test_rows_on_other_data_have_as_many_steps_as_the_others():
    table = load_table(SWEEPS / "comparison.yaml")
    assert "voxformer_pinhole@same" in [row.run for row in table.rows]
    named = table.of_steps("250")
    assert "voxformer_pinhole@250" in [row.run for row in named.rows]
    assert named.claims[0] == ("voxformer_pinhole@250", "bevdet")
    assert [row.title for row in named.rows] == [row.title for row in table.rows]


def test_rows_share_stages_unless_they_stand_alone():
    table = load_table(SWEEPS / "sketch.yaml")
    rows = {row.run: row for row in table.rows}
    assert table.shares_stages(rows["ours"], rows["wo_dilation"])
    assert not table.shares_stages(rows["ours"], rows["mono"])
    assert not table._replace(compares="systems").shares_stages(rows["ours"], rows["wo_dilation"])
    shares_depth = {
        compares: table._replace(compares=compares).shares_depth(rows["ours"], rows["wo_dilation"])
        for compares in ("parts", "grids", "systems")
    }
    assert shares_depth == {"parts": True, "grids": True, "systems": False}
    assert not table._replace(compares="grids").shares_stages(rows["ours"], rows["wo_dilation"])
    assert not table.shares_depth(rows["ours"], rows["mono"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("order_by: [a", "is damaged: the file is not valid YAML: line 2: while parsing"),
        ("- order_by", "it holds no keys and values"),
        ("order_by: a\ncolumns: {a: A}\nrows: [ours]", "is not a table of the paper"),
    ],
)
def test_a_file_that_is_no_table_is_named(tmp_path, text, message):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=rf"bad\.yaml.*{message}"):
        load_table(path) if is_table(path) else None
