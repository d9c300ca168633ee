import json

from omniocc.config import CONF
from omniocc.report.wandb.dashboard import SLOTS, sections, workspace

SECTIONS = sections(
    {"test/rayiou/tree": 0.5, "test/rayiou/car": 0.2, "test/rayiou_20-40m": 0.1, "test/rayiou_0-20m": 0.4}
)


def panels_of(board):
    """Kind and text of every panel, by section, as the server gets them."""
    spec = board._model.model_dump(mode="json", by_alias=True, exclude_none=True)["spec"]["section"]
    return {
        section["name"]: [(panel["viewType"], json.dumps(panel)) for panel in section["panels"]]
        for section in spec["panelBankConfig"]["sections"]
    }


def test_sections_and_panels_arrive_with_their_keys():
    panels = panels_of(workspace("me", "omniocc", SECTIONS))
    assert list(panels) == ["compare rows", "by range", "by class", "depth and sketch", "images"]
    for name, charts in SECTIONS.items():
        assert len(panels[name]) == len(charts)
        for (_, text), chart in zip(panels[name], charts, strict=True):
            assert all(f'{key}"' in text for key in chart.keys), chart
    kinds = {kind for section in panels.values() for kind, _ in section}
    assert kinds == {"Bar Chart", "Run History Line Plot", "Scatter Plot", "Media Browser", "Weave"}


def test_runs_are_grouped_by_stage_and_row():
    groupby = workspace("me", "omniocc", SECTIONS).runset_settings.groupby
    assert [metric.name for metric in groupby] == ["JobType", "row"]


def test_classes_and_bands_are_those_of_the_run():
    charts = {(section, chart.title): chart.keys for section, part in SECTIONS.items() for chart in part}
    assert charts["by class", "voxel RayIoU by class"] == ("test/rayiou/tree", "test/rayiou/car")
    assert charts["by range", "voxel RayIoU by range, m"] == ("test/rayiou_0-20m", "test/rayiou_20-40m")
    assert charts["depth and sketch", "depth: mean relative error (AbsRel)"] == (
        "test/depth/absrel_0-20m",
        "test/depth/absrel_20-40m",
    )


def test_no_two_panels_have_one_title_and_the_options_are_columns():
    titles = [chart.title for part in SECTIONS.values() for chart in part]
    assert len(set(titles)) == len(titles)
    columns = workspace("me", "omniocc", SECTIONS).runset_settings.pinned_columns
    slots = [path.name for path in (CONF / "model").iterdir() if path.is_dir()]
    assert {f"config:slots.{slot}" for slot in SLOTS} <= set(columns) & {f"config:slots.{slot}" for slot in slots}


def test_the_shortest_training_has_a_curve_of_its_loss(smoke):
    cfg = smoke()
    assert cfg.trainer.log_every_n_steps * 2 <= min(
        cfg.stages[stage].max_steps for stage in ("depth", "sketch", "occupancy")
    )
