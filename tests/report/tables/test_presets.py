from omniocc.report.tables.presets import presets_chapter

from omniocc.report.runs import FinishedRun


def run(name: str, rayiou: float, stages: dict[str, int], earlier: float) -> FinishedRun:
    facts = {"preset": "small", "steps": stages["occupancy"], "data": "0123456789", "seed": 3, "stages": stages}
    facts |= {"minutes of training": 2.5, "minutes of earlier stages": earlier, "peak MiB": 900}
    metrics = {"test/rayiou": rayiou, "test/rayiou_0-8.5m": 0.5, "test/lidar/rayiou": 0.25, "test/voxel/iou": 0.75}
    return FinishedRun(name, facts, metrics | {"test/voxel/miou": 0.125}, config={})


def test_every_setting_has_a_table_with_steps_and_minutes_of_all_stages():
    ours = run("ours-01", 0.375, {"depth": 8, "sketch": 5, "occupancy": 10}, 1.25)
    text = presets_chapter([[ours, run("dense-02", 0.2, {"occupancy": 10}, 0)], [ours]])
    assert text.count("### preset=small, data 01234567") == 2
    lines = text.splitlines()
    assert "| run | seed | steps | minutes | MiB, peak | RayIoU | 0-8.5m | RayIoU, LiDAR | mIoU | IoU |" in lines
    assert "| ours-01 | 3 | 8/5/10 | 3.8 | 900 | 0.375 | 0.500 | 0.250 | 0.125 | 0.750 |" in lines
    assert "| dense-02 | 3 | –/–/10 | 2.5 | 900 | 0.200 | 0.500 | 0.250 | 0.125 | 0.750 |" in lines


def test_without_other_presets_there_is_no_page():
    assert presets_chapter([]) == ""
