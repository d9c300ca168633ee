from omniocc.report.tables.budget import budget_cells, yardstick_cells
from omniocc.report.runs import FinishedRun
from omniocc.run.cost import GFLOP, PARAMETERS, PEAK

STAGES = {"depth": {"max_steps": 800}, "sketch": {"max_steps": 500}}
CYLINDER = {"_target_": "omniocc.geometry.Cylinder", "shape": [64, 100, 8]}


def run(seed, sketch, prior=0.06, **facts):
    config = {"model": {"sketch": sketch, "geometry": CYLINDER}, "stages": STAGES, "data": {"batch_size": 2}}
    metrics = {"prior/rayiou": prior, "prior/lidar/rayiou": 0.07, "label/rayiou": 1.0, "label/lidar/rayiou": 0.41}
    return FinishedRun(f"row-0000000{seed}", {"seed": seed, "steps": 1000, **facts}, metrics, config=config)


def cost(minutes, mib):
    return {"minutes of training": minutes, PEAK: mib, PARAMETERS: 1.147, GFLOP: 16.72}


def test_a_row_with_a_learned_sketch_has_had_two_stages_before():
    learned = [run(seed, {"depth": {}}, **cost(minutes, 900 + seed)) for seed, minutes in enumerate((8.0, 9.0))]
    rows = {"ours": learned, "dense": [run(0, {}, **cost(18.84, 1500.0))]}
    head, lines = budget_cells(rows)
    assert lines == [
        ["ours", "1.15", "16.7", "800", "500", "1000", "2", "8.5", "901"],
        ["dense", "1.15", "16.7", "–", "–", "1000", "2", "18.8", "1500"],
    ]
    assert len(head) == len(lines[0])


def test_what_older_runs_did_not_record_is_a_dash():
    older, newer = run(0, {}, **{"minutes of training": 7.0}), run(1, {}, **cost(8.0, 1000.0))
    assert budget_cells({"bevdet": [older]})[1][0][1:3] == ["–", "–"]
    assert budget_cells({"bevdet": [older, newer]})[1][0] == [
        "bevdet", "1.15", "16.7", "–", "–", "1000", "2", "7.5", "1000",
    ]  # fmt: skip


def test_yardsticks_stand_once_for_each_grid():
    head, lines = yardstick_cells({"ours": [run(0, {}), run(1, {})], "mono": [run(0, {})]})
    assert lines == [["cylinder 64x100x8", "0.060", "0.070", "1.000", "0.410"]]
    assert len(head) == len(lines[0])
