"""Lines below the tables of a report that say how scores were counted."""

from pathlib import Path

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.claims import verdicts_of
from omniocc.report.tables.paper import load_table
from omniocc.report.tables.protocol import counted_alike, protocol_lines, protocol_list
from omniocc.report.tables.verdicts import verdicts_parts

RAYS = {"rayiou": "rays from the ego origin", "voxel": "cells"}
OTHER = {"rayiou": "rays from eight origins", "voxel": "cells"}
KEYS = ["test/rayiou", "test/rayiou_0-8.5m", "test/voxel/miou", "test/depth/mae", "voxels"]


def runs(*protocols):
    return [
        FinishedRun(f"run-0000000{k}", {} if one is None else {"protocol": one}, {}) for k, one in enumerate(protocols)
    ]


def test_one_line_where_all_rows_agree():
    rows = {"ours": runs(RAYS, RAYS), "mono": runs(RAYS)}
    assert protocol_lines(rows, KEYS) == ["Voxel RayIoU: rays from the ego origin.", "IoU, mIoU: cells."]
    assert protocol_lines(rows, ["test/lidar/rayiou", "test/sketch/recall"]) == []


def test_rows_are_named_where_they_differ():
    rows = {"ours": runs(RAYS, OTHER), "mono": runs(RAYS), "old": runs(None)}
    assert protocol_lines(rows, KEYS) == [
        "Voxel RayIoU (all rows but old): rays from the ego origin.",
        "Voxel RayIoU (ours): rays from eight origins.",
        "IoU, mIoU (all rows but old): cells.",
    ]
    assert protocol_lines({"ours": runs(RAYS, OTHER)}, KEYS[:1]) == [
        "Voxel RayIoU (all rows): rays from the ego origin.",
        "Voxel RayIoU (all rows): rays from eight origins.",
    ]


def test_a_line_that_says_more_at_its_end_holds_for_both():
    before, now = "rays; mean over classes", "rays; mean over classes; rays without a return are free"
    rows = {"old": runs({"lidar/rayiou": before}), "new": runs({"lidar/rayiou": now}, {"lidar/rayiou": before})}
    assert protocol_lines(rows, ["test/lidar/rayiou"]) == [f"Surface RayIoU: {now}."]
    rows["other"] = runs({"lidar/rayiou": "rays; mean over classes and more"})
    assert protocol_lines(rows, ["test/lidar/rayiou"]) == [
        f"Surface RayIoU (all rows but other): {now}.",
        "Surface RayIoU (other): rays; mean over classes and more.",
    ]


def test_pages_have_short_points_and_count_the_rows_without_a_record():
    told = {"rayiou": "rays from the ego origin; correct: same class; mIoU: mean"}
    rows = {"ours": runs(told), "mono": runs(told), "old": runs(None)}
    points = "* Rays from the ego origin.\n* Correct: same class.\n* mIoU: mean."
    assert protocol_list(rows, KEYS) == [f"**Voxel RayIoU**\n\n{points}\n* Not recorded for 1 of 3 rows."]
    rows["other"] = runs(OTHER)
    assert [text.splitlines()[-1] for text in protocol_list(rows, KEYS[:1])] == [
        "* These rows: ours, mono.",
        "* These rows: other.",
    ]


def test_scores_counted_in_two_ways_are_not_compared():
    first, second, old = runs(RAYS), runs(OTHER), runs(None)
    assert counted_alike([*first, *old], "test/rayiou")
    assert not counted_alike([*first, *second, *old], "test/rayiou_0-8.5m")
    assert counted_alike([*first, *second], "test/voxel/miou")
    longer = runs({kind: f"{text}; lost rays are free" for kind, text in RAYS.items()})
    assert counted_alike([*first, *longer], "test/rayiou")


def test_claims_about_rows_counted_in_two_ways_are_not_decided():
    table = load_table(Path(__file__).parents[3] / "sweeps" / "sketch.yaml")
    rows = {
        row: [FinishedRun(f"{row}-0000000{k}", {"seed": k, "protocol": RAYS}, {"test/rayiou": k / 10}) for k in (1, 2)]
        for row in ("ours", "dense", "random")
    }
    rows["random"] = [run._replace(facts=run.facts | {"protocol": OTHER}) for run in rows["random"]]
    part, *_ = verdicts_parts([table], rows, verdicts_of([table], rows))
    assert {line[0]: line[2] for line in part.cells[1]} == {
        "Sketch ahead of all voxels": "undecided",
        "Sketch ahead of random voxels": "not compared: other protocols",
        "Dilation helps": "not run",
        "Omnidirectional ahead of monocular depth": "not run",
    }


def test_records_of_before_have_no_line():
    assert protocol_lines({"ours": runs(None, None)}, KEYS) == []
