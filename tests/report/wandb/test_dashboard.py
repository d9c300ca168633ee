import json

from omniocc.report.wandb.dashboard import KEYS, SECTIONS, workspace


def panels_of(board):
    """Kind and text of every panel, by section, as the server gets them."""
    spec = board._model.model_dump(mode="json", by_alias=True, exclude_none=True)["spec"]["section"]
    return {
        section["name"]: [(panel["viewType"], json.dumps(panel)) for panel in section["panels"]]
        for section in spec["panelBankConfig"]["sections"]
    }


def test_sections_and_panels_arrive_with_their_keys():
    panels = panels_of(workspace("me", "omniocc"))
    assert list(panels) == ["compare rows", "by range", "by class", "depth and sketch", "pictures"]
    for name, charts in SECTIONS.items():
        assert len(panels[name]) == len(charts)
        for (_, text), chart in zip(panels[name], charts, strict=True):
            assert all(f'{key}"' in text for key in chart.keys), chart
    kinds = {kind for section in panels.values() for kind, _ in section}
    assert kinds == {"Bar Chart", "Run History Line Plot", "Scatter Plot", "Media Browser", "Weave"}


def test_runs_are_grouped_by_stage_and_row():
    groupby = workspace("me", "omniocc").runset_settings.groupby
    assert [metric.name for metric in groupby] == ["JobType", "row"]


def test_keys_are_written_out():
    assert {"test/rayiou_0-8.5m", "test/rayiou/Pedestrian", "test/depth/mae_17-25.6m", "test/rayiou@4"} <= KEYS
    assert not [key for key in KEYS if "{" in key]
