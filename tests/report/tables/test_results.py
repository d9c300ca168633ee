"""Every claim of the paper in one table, from made records whose verdicts are known."""

from pathlib import Path

import pytest
from fake_scene import FakeWorld
from fake_sweep import CYLINDER, DENSE, OMNI, write_run

from omniocc.errors import UserError
from omniocc.report.docs import BEGIN, END, results_block, write_block, write_docs
from omniocc.report.sweep import Sweep, read_sweeps
from omniocc.report.tables.results import remark_lines, results_lines

ROOT = Path(__file__).parents[3]
SPREAD = (-0.001, 0.0, 0.001)
"""What each seed adds to the score of its row."""
RECORDS = [  # row, steps, sketch, score of the seeds, score by rays to the surfaces if not half of that
    ("ours", 1000, OMNI, 0.300, None),
    ("wo_semantic_head", 1000, OMNI, 0.280, None),  # behind by both metrics
    ("wo_refine", 1000, OMNI, 0.270, 0.150),  # as good by rays to the surfaces
    ("wo_temporal", 1000, OMNI, 0.320, None),  # ahead
    ("wo_dilation", 1000, OMNI, (0.2960, 0.3030, 0.2980), None),  # no gap, and too much noise to exclude one
    ("dense", 1000, DENSE, 0.200, None),
    ("dense_budget", 3100, DENSE, 0.330, None),  # ahead with as many steps as all stages of ours
    ("ours", 10000, OMNI, 0.400, None),
    ("wo_temporal", 10000, OMNI, 0.380, None),
]


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Sweep:
    folder = tmp_path_factory.mktemp("claims")
    world = FakeWorld(str(folder / "data"))
    world.prepare()
    for number, (row, steps, sketch, score, surface) in enumerate(RECORDS):
        scores = score if isinstance(score, tuple) else tuple(score + more for more in SPREAD)
        for seed, value in enumerate(scores):
            name = f"{row}-{number:04x}{seed:04x}"
            write_run(
                folder / name, seed, value, world, sketch, CYLINDER, steps, surface and surface + SPREAD[seed] / 2
            )
    return read_sweeps(folder, ROOT / "sweeps", ROOT / "conf", None)[0]


def claims(lines: list[str]) -> dict[str, list[str]]:
    """Return the cells of each claim that is told, behind its words."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return {cells[1]: [cells[0], *cells[2:]] for cells in rows if cells[0].strip("IV") == ""}


def test_every_claim_has_its_figures_and_symbols(sweep):
    lines = results_lines(sweep)
    assert "| Table | Claim | Paper | Here | Verdict | Equal budget | 10x steps |" in lines
    assert "| --- | --- | ---: | ---: | --- | ---: | ---: |" in lines
    found = claims(lines)
    assert len(found) == 17
    told = {words: cells for words, cells in found.items() if cells[3] != "–"}
    assert told == {
        "2D semantic head helps": ["IV", "+0.027 (0.470 / 0.443)", "+0.020 (0.300 / 0.280)", "✅", "=", "–"],
        "Temporal fusion helps": ["IV", "+0.012 (0.470 / 0.458)", "-0.020 (0.300 / 0.320)", "❌", "=", "✅ +0.020"],
        "Refine module helps": ["V", "+0.079 (0.470 / 0.391)", "+0.030 (0.300 / 0.270)", "☑", "=", "–"],
        "Dilation helps": ["VI", "+0.005 (0.470 / 0.465)", "+0.001 (0.300 / 0.299)", "❓", "=", "–"],
        "Sketch ahead of all voxels": [
            "VI",
            "+0.036 (0.470 / 0.434)",
            "+0.100 (0.300 / 0.200)",
            "✅",
            "❌ -0.030",
            "–",
        ],
    }
    assert found["Cylinder ahead of cuboid"] == ["VII", "+0.066 (0.454 / 0.388)", "–", "–", "–", "–"]


def test_the_headline_counts_what_holds(sweep):
    first = results_lines(sweep)[0]
    assert first.startswith(
        "**3 of the paper's 17 claims hold here, 1 does not, 1 is undecided, 12 have not run.** A re-"
    )
    assert first.endswith("`preset=tiny`, 1,000 steps of occupancy training, 3 seeds.")
    more = "* 10x steps: 10,000 steps of occupancy training, 3 seeds. 1 claim holds, 16 have not run."
    assert more in remark_lines(sweep)


def test_without_more_steps_the_table_has_no_column_of_them(sweep):
    lines = results_lines(sweep._replace(longer=[]))
    assert "| Table | Claim | Paper | Here | Verdict | Equal budget |" in lines
    assert not any("10x steps" in line for line in [*lines, *remark_lines(sweep._replace(longer=[]))])


def test_unknown_steps_are_named_so(sweep):
    runs = [run._replace(facts={key: run.facts[key] for key in ("seed", "preset", "data")}) for run in sweep.runs]
    lines = results_lines(sweep._replace(runs=runs))
    assert "| Table | Claim | Paper | Here | Verdict | Equal budget | 10,000 steps |" in lines
    assert lines[0].endswith("`preset=tiny`, unknown steps of occupancy training, 3 seeds.")


def test_distance_shows_the_paper_beside_ours(sweep):
    (line,) = [line for line in results_lines(sweep) if line.startswith("| OmniDepth-Occ |")]
    assert line == "| OmniDepth-Occ | 0.496 | 0.300 | 0.446 | 0.150 | 0.294 | 0.075 |"


def test_reasons_stand_where_a_claim_does_not_hold_and_a_wrong_one_is_named(sweep):
    reasons = [line.strip(" *").partition(":")[0] for line in remark_lines(sweep) if line.startswith("  * ")]
    assert reasons == ["Temporal fusion helps", "Dilation helps"]
    mistyped = [table._replace(reasons={"Fusion helps": "why"}) for table in sweep.tables if table.number == 4]
    with pytest.raises(UserError, match="semantic_temporal: reasons has 'Fusion helps'"):
        remark_lines(sweep._replace(tables=mistyped))


def test_tables_that_are_not_the_papers_give_no_results(sweep, tmp_path):
    own = sweep._replace(tables=[table for table in sweep.tables if not table.number])
    assert results_lines(own) == []
    assert "index.md" not in {path.name for path in write_docs([own], tmp_path)}


def test_results_are_written_between_their_marks_alone(sweep, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"{END}\nbefore\n{BEGIN}\nold\n{END}\nafter\n")
    write_block(page, results_block(sweep))
    written = "\n".join([END, "before", BEGIN, *results_lines(sweep), END, "after", ""])
    assert page.read_text() == written
    write_block(page, results_block(sweep))
    assert page.read_text() == written
    page.write_text(f"{END}\n{BEGIN}\n")
    with pytest.raises(UserError, match=r"page\.md has no place for the results"):
        write_block(page, results_block(sweep))
