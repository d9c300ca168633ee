"""How many seeds a gap needs."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.tables import power
from omniocc.report.tables.claims import Rows
from omniocc.report.tables.paper import PaperTable, load_table
from omniocc.report.tables.power import SeedStd, freedom_of_parts, freedom_of_systems, load_seed_stds, seeds_needed

SWEEPS = Path(__file__).parents[3] / "sweeps"
TABLES = [load_table(SWEEPS / f"{name}.yaml") for name in ("comparison", "sketch")]
KEY = "test/rayiou"


@pytest.mark.parametrize(("size", "seeds"), [(0.2, 394), (0.5, 64), (0.8, 26), (1.0, 17)])
def test_two_samples_need_what_cohen_says(size, seeds):
    """Cohen, Statistical Power Analysis (1988), table 2.4.1, two-tailed 5 %, power .8; exact values as in G*Power."""
    assert seeds_needed(size, 1.0, freedom_of_systems, 1) == seeds


def test_pairs_need_what_gpower_says():
    """G*Power, difference of two dependent means: 34 pairs for .5 standard deviations of the difference."""
    std = 1 / np.sqrt(2)  # of one of the two
    assert seeds_needed(0.5, std, lambda seeds: freedom_of_parts(seeds, 2), 1) == 34
    assert freedom_of_parts(7, 2) == 6


def test_the_freedom_is_that_of_rows_and_seeds():
    """Eleven rows, two with five seeds and nine with three: ones for rows and seeds, less one that both have."""
    design = [(row, 11 + seed) for row in range(11) for seed in range(5 if row < 2 else 3)]
    matrix = np.zeros((len(design), 16))
    for line, places in enumerate(design):
        matrix[line, list(places)] = 1
    assert freedom_of_parts(5, 11) == len(design) - np.linalg.matrix_rank(matrix)
    assert freedom_of_parts(2, 11) == 31 - (11 + 3 - 1)


def test_the_power_is_that_of_simulated_runs():
    """4,000 sweeps of two systems with four seeds each, at 5 % / 10."""
    draw, seeds, size = np.random.default_rng(1), 4, 3.0
    better, other = draw.normal(size, 1, (4000, seeds)), draw.normal(0, 1, (4000, seeds))
    found = stats.ttest_ind(better, other, axis=1)
    rate = ((found.pvalue < 0.05 / 10) & (found.statistic > 0)).mean()
    expected = power.power_of(size, np.sqrt(2 / seeds), freedom_of_systems(seeds), 10)
    assert rate == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 4000))


def test_more_claims_and_larger_standard_deviations_need_more_seeds():
    few, many = (seeds_needed(1.0, 1.0, freedom_of_systems, claims) for claims in (1, 20))
    assert few is not None
    assert many is not None
    assert few < many
    assert seeds_needed(0.01, 1.0, freedom_of_systems, 20) is None


def runs(name: str, *values: float) -> list[FinishedRun]:
    return [FinishedRun(f"{name}-{k:08x}", {"seed": k}, {KEY: value}) for k, value in enumerate(values)]


def test_the_standard_deviations_of_the_runs_are_measured_where_rows_have_two_seeds():
    rows = {"ours": runs("ours", 0.30, 0.34), "wo_dilation": runs("wo", 0.20, 0.22), "dense": runs("dense", 0.1, 0.1)}
    found = power.measure_seed_std(TABLES, rows, KEY)
    assert found is not None
    # of `ours` and `dense`; and of ours - wo_dilation, which is .1 and .12, for one of the two
    assert found.systems == pytest.approx(np.sqrt((0.0008 + 0) / 2))
    assert found.parts == pytest.approx(np.std([0.10, 0.12], ddof=1) / np.sqrt(2))
    assert power.measure_seed_std(TABLES, {"ours": runs("ours", 0.3)}, KEY) is None


def needed(tables: list[PaperTable], rows: Rows, *stds: SeedStd) -> dict[str, list[str]]:
    """Return the seeds that each claim needs at every standard deviation."""
    found: dict[str, list[str]] = {}
    for line in csv.DictReader(power.power_csv(tables, rows, stds).splitlines()):
        found.setdefault(line["claim"], []).append(list(line.values())[-1])
    return found


def test_the_file_has_every_claim_and_standard_deviation():
    rows = {"ours": runs("ours", 0.235)}
    found = needed(TABLES, rows, SeedStd("notes", 0.002, 0.01), SeedStd("other notes", 0.0001, 0.0001))
    assert len(found) == 9
    part = seeds_needed(0.235 * 0.005 / 0.470, 0.002, lambda seeds: freedom_of_parts(seeds, 2), 9)
    assert found["Dilation helps"] == [str(part), "3"]
    assert found["Sketch ahead of all voxels"] == [str(seeds_needed(0.018, 0.01, freedom_of_systems, 9)), "2"]
    assert needed(TABLES, {}, SeedStd("notes", 0.002, 0.01))["Dilation helps"] == ["unknown"]
    assert needed(TABLES, rows) == {}


def test_the_noise_of_parts_is_that_of_the_rows_on_the_main_data():
    """Of a table and a copy of it on other data, the five rows of the first."""
    table = TABLES[1]._replace(rows=[row._replace(alone=False) for row in TABLES[1].rows])
    other = table._replace(name="other", rows=[row._replace(run=f"{row.run}@1000") for row in table.rows])
    found = needed([table, other], {"ours": runs("ours", 0.47)}, SeedStd("notes", 0.002, 0.01))
    assert found["Dilation helps"] == [
        str(seeds_needed(0.005, 0.002, lambda seeds: freedom_of_parts(seeds, 5), 8)),
        "unknown",
    ]


def test_standard_deviations_are_read_and_wrong_ones_are_named(tmp_path):
    assert [entry.parts for entry in load_seed_stds(SWEEPS / "power.yaml")] == [0.0018, 0.005]
    assert load_seed_stds(tmp_path / "power.yaml") == []
    path = tmp_path / "power.yaml"
    for text in (
        "seed_stds: [{source: a, parts: 0.1}]",
        "seed_stds: [{source: a, parts: 0.1, systems: b}]",
        "kind: power",
    ):
        path.write_text(text)
        with pytest.raises(UserError, match=r"power\.yaml: every entry"):
            load_seed_stds(path)
    path.write_text("seed_stds: [{source: a, parts: 0, systems: 1}]")
    with pytest.raises(UserError, match="above 0"):
        load_seed_stds(path)
