"""Notebooks run from first to last cell at the smallest size, as plain Python, and are kept without outputs."""

import json
from pathlib import Path

import matplotlib as mpl
import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def code_of(path):
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


@pytest.mark.whole_runs
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.slow
def test_a_notebook_runs(path, data_root, runs, monkeypatch, capsys):
    monkeypatch.chdir(FOLDER)
    for name, value in (("PRESET", "smoke"), ("DATA", data_root), ("RUNS", runs)):
        monkeypatch.setenv(f"OMNIOCC_{name}", str(value))
    names: dict[str, object] = {}
    with mpl.rc_context({"backend": "Agg"}):
        for number, cell in enumerate(code_of(path)):
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)
    assert capsys.readouterr().out


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stripped(path):
    for cell in code_of(path):
        assert (cell["outputs"], cell["execution_count"]) == ([], None)


def test_rayiou_by_hand_is_that_of_the_package(data_root, monkeypatch, capsys):
    monkeypatch.chdir(FOLDER)
    monkeypatch.setenv("OMNIOCC_PRESET", "smoke")
    monkeypatch.setenv("OMNIOCC_DATA", str(data_root))
    names: dict = {}
    for cell in code_of(FOLDER / "3_rayiou.ipynb")[:5]:
        exec("".join(cell["source"]), names)
    by_hand = [float(line.split(": ")[1]) for line in capsys.readouterr().out.splitlines() if "RayIoU at" in line]
    scores = names["metric"].compute()
    assert by_hand == pytest.approx([float(scores[f"rayiou@{threshold}"]) for threshold in (1, 2, 4)], abs=6e-4)


def test_there_are_four_notebooks():
    assert [path.stem[0] for path in NOTEBOOKS] == ["1", "2", "3", "4"]
