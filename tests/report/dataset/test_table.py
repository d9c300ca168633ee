"""The comparison of datasets."""

from pathlib import Path

import pytest

from omniocc.errors import UserError
from omniocc.report.datasets import (
    dataset_cells,
    dataset_csv,
    dataset_latex,
    facts_of_scenes,
    is_dataset_table,
    load_dataset_table,
    with_records,
)
from omniocc.report.runs import read_runs
from omniworld.page import OTHER_DATASETS

PATH = Path(__file__).parents[3] / "sweeps" / "dataset.yaml"


def test_the_papers_rows_are_those_on_the_page_of_a_dataset():
    table = load_dataset_table(PATH)
    rows = [(name.removesuffix(" (paper)"), *cells) for name, cells in table.rows]
    assert rows == [(name.removesuffix(" (paper)"), *cells) for name, *cells in OTHER_DATASETS]
    assert is_dataset_table(PATH)
    assert not is_dataset_table(PATH.with_name("sketch.yaml"))


def test_our_row_is_that_of_the_configurations_of_the_runs(runs):
    first, *others = read_runs(runs)
    table = with_records(load_dataset_table(PATH), [first, *others])
    assert dataset_cells(table)[1][-1] == ["OmniDepth-Occ (here)", "–", "✓", "✓", "✓", "✓", "16"]
    assert dataset_csv(table).splitlines()[-1] == "OmniDepth-Occ (here),no,yes,yes,yes,yes,16"
    assert r"OmniDepth-Occ (paper) & \checkmark & \checkmark" in dataset_latex(table)
    source = first.config["data"]["source"] | {"rig": "pinhole6"}
    pinhole = first._replace(config={"data": {"source": source}})
    assert with_records(load_dataset_table(PATH), [first, pinhole]).rows[-1][1][:2] == [True, True]
    assert with_records(load_dataset_table(PATH), [first._replace(config={})]) == load_dataset_table(PATH)


def test_scenes_and_frames_are_those_of_the_configuration(runs):
    run = read_runs(runs)[0]
    assert facts_of_scenes(run) == (
        "2 scenes (8 frames) for train, 1 scenes (4 frames) for val, 1 scenes (4 frames) for test; 2 kinds of places."
    )
    assert facts_of_scenes(run._replace(config={"data": {"source": {"_target_": "omniocc.data.Recorded"}}})) == ""
    assert facts_of_scenes(run._replace(config={})) == ""


def test_a_row_with_too_few_cells_is_named(tmp_path):
    path = tmp_path / "dataset.yaml"
    path.write_text("title: t\nnote: n\ncolumns: {a: A, b: B}\nrows: {mine: {title: M, paper: [true]}}\n")
    with pytest.raises(UserError, match=r"mine.* 1 cell.* 2 columns"):
        load_dataset_table(path)
