"""What rows were given and what they cost."""

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.budget import budget_cells, note
from omniocc.report.tables.names import named
from omniocc.runs.cost import GFLOP, PARAMETERS, PEAK

BEFORE = {"depth": 800, "sketch": 500}


def run(seed, stages, **facts):
    recorded = {"seed": seed, "steps": 1000, "stages": {**stages, "occupancy": 1000}}
    return FinishedRun(f"row-0000000{seed}", recorded | facts, {}, config={"data": {"batch_size": 2}})


def cost(minutes, mib):
    return {"minutes of training": minutes, PEAK: mib, PARAMETERS: 1.147, GFLOP: 16.72}


def test_a_row_with_a_learned_sketch_has_two_stages_before():
    before = {"minutes of earlier stages": 16.8}
    learned = [run(seed, BEFORE, **cost(minutes, 900 + seed), **before) for seed, minutes in enumerate((8.0, 9.0))]
    rows = {"ours": learned, "dense": [run(0, {}, **cost(18.84, 1500.0))]}
    head, lines = budget_cells(rows, {"ours": "OmniDepth-Occ"})
    assert lines == [
        ["OmniDepth-Occ", "1.15", "16.7", "800", "500", "1000", "2300", "2", "8.5", "25.3", "901"],
        ["dense", "1.15", "16.7", "–", "–", "1000", "1000", "2", "18.8", "18.8", "1500"],
    ]
    assert len(head) == len(lines[0])


def test_the_note_names_the_machines_of_the_runs():
    one, other = "AMD EPYC, 2 cores, torch 2.13.0+cpu", "NVIDIA H200, Xeon, 16 cores, torch 2.11.0+cu130"
    rows = {"ours": [run(0, {}, machine=one), run(1, {}, machine=one)._replace(name="row-b")]}
    assert note(rows).endswith(f"over seeds. Machines: {one} (2 runs).")
    rows["dense"] = [run(2, {}, machine=other), run(3, {})]
    machines = f"Machines: {one} (2 runs); {other} (1 run); not recorded (1 run). Compare operations"
    assert machines in note(rows)


def test_what_a_run_did_not_record_is_a_dash():
    first, second = run(0, {}, **{"minutes of training": 7.0}), run(1, {}, **cost(8.0, 1000.0))
    assert budget_cells({"bevdet": [first]}, {})[1][0][1:3] == ["–", "–"]
    assert budget_cells({"bevdet": [first, second]}, {})[1][0] == [
        "bevdet",
        "1.15",
        "16.7",
        "–",
        "–",
        "1000",
        "1000",
        "2",
        "7.5",
        "7.5",
        "1000",
    ]
    assert budget_cells({"mine": [FinishedRun("mine-00000000", {}, {})]}, {})[1] == [["mine", *["–"] * 10]]


def test_a_row_of_a_number_of_steps_names_them():
    names = {"ours": "OmniDepth-Occ", "bevformer_budget": "BEVFormer (bevformer_budget)"}
    assert named("ours@1000", names) == "OmniDepth-Occ, 1,000 steps"
    assert named("bevformer_budget@3100", names) == "BEVFormer, 3,100 steps"
    assert named("bevformer_budget", names) == "BEVFormer (bevformer_budget)"
