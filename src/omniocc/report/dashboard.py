"""The W&B dashboard as code: `python -m omniocc.report.dashboard` saves it to a project.

Everything it shows is logged by the runs themselves; `KEYS` are tested against a run.
"""

import argparse
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from omniocc.config import lines_not_tracebacks
from omniocc.errors import UserError
from omniocc.run.wandb.loggers import logged_in
from omniocc.run.wandb.result_tables import BANDS, CLASS_NAMES

if TYPE_CHECKING:
    from wandb_workspaces.workspaces import Section, Workspace

STEP = "trainer/global_step"


class Chart(NamedTuple):
    """One panel.

    Attributes:
        kind: bars and scatter show the figures of the test, lines the curves of training.
        title: above it.
        keys: what is drawn; of a scatter first x, then y.
    """

    kind: Literal["bars", "lines", "scatter", "media", "table"]
    title: str
    keys: tuple[str, ...]


def each(key: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    """The key with every part in place of `{}`."""
    return tuple(key.format(part) for part in parts)


SECTIONS: dict[str, tuple[Chart, ...]] = {
    "compare rows": (
        Chart("bars", "RayIoU", ("test/rayiou",)),
        Chart("bars", "RayIoU by threshold", each("test/rayiou@{}", ("1", "2", "4"))),
        Chart("bars", "RayIoU against LiDAR rays", ("test/lidar/rayiou",)),
        Chart("bars", "voxel IoU and mIoU", ("test/voxel/iou", "test/voxel/miou")),
        Chart("bars", "yardsticks: prior, and label against LiDAR rays", ("prior/rayiou", "label/lidar/rayiou")),
        Chart("lines", "RayIoU of validation", ("val/rayiou",)),
        Chart("lines", "loss", ("train/loss",)),
    ),
    "by range": (
        Chart("bars", "RayIoU", each("test/rayiou_{}", BANDS)),
        Chart("bars", "RayIoU against LiDAR rays", each("test/lidar/rayiou_{}", BANDS)),
        Chart("lines", "RayIoU of validation", each("val/rayiou_{}", BANDS)),
        Chart("table", "by range", ("tables/by_range",)),
    ),
    "by class": (
        Chart("bars", "RayIoU", each("test/rayiou/{}", CLASS_NAMES)),
        Chart("bars", "RayIoU against LiDAR rays", each("test/lidar/rayiou/{}", CLASS_NAMES)),
        Chart("bars", "voxel IoU", each("test/voxel/iou/{}", CLASS_NAMES)),
        Chart("table", "by class", ("tables/by_class",)),
    ),
    "depth and sketch": (
        Chart("bars", "depth: mean error, m", each("test/depth/mae_{}", BANDS)),
        Chart("bars", "depth: AbsRel", each("test/depth/absrel_{}", BANDS)),
        Chart("bars", "sketch: recall of occupied voxels", each("test/sketch/recall_{}", BANDS)),
        Chart("bars", "sketch: precision", each("test/sketch/precision_{}", BANDS)),
        Chart("scatter", "RayIoU against fraction of candidates", ("test/sketch/fraction", "test/rayiou")),
        Chart("scatter", "recall against fraction of candidates", ("test/sketch/fraction", "test/sketch/recall")),
    ),
    "pictures": (
        Chart("media", "truth beside prediction", ("test/voxels",)),
        Chart("media", "cameras with predicted semantics", ("test/cameras",)),
        Chart("media", "from above: truth, prediction, differences", ("test/bev",)),
        Chart("media", "true voxels", ("test/points_truth",)),
        Chart("media", "predicted voxels", ("test/points_prediction",)),
        Chart("media", "panoramas of range", ("test/erp",)),
        Chart("media", "depth", ("test/depth",)),
        Chart("media", "candidates", ("test/sketch",)),
        Chart("media", "while training", ("val/voxels",)),
    ),
}
KEYS = frozenset(key for charts in SECTIONS.values() for chart in charts for key in chart.keys)
ONE_COLUMN = ("table", "media")


def workspace(entity: str, project: str) -> "Workspace":
    """The dashboard, not saved yet: runs grouped by job type (stage) and row, so that bars are means over seeds.

    Args:
        entity: W&B user or team.
        project: W&B project.

    Raises:
        UserError: when the extra `dashboard` is not installed.
    """
    try:
        from wandb_workspaces import workspaces as ws
    except ImportError as error:
        raise UserError("the dashboard needs wandb-workspaces: pip install --editable '.[dashboard]'") from error
    return ws.Workspace(
        entity=entity,
        project=project,
        name="OmniDepth-Occ",
        sections=[_section(name, charts) for name, charts in SECTIONS.items()],
        settings=ws.WorkspaceSettings(x_axis=STEP, max_runs=40),
        runset_settings=ws.RunsetSettings(
            groupby=[ws.Metric("JobType"), ws.Config("row")],
            pinned_columns=["config:preset.name", "config:seed", "summary:test/rayiou", "summary:test/lidar/rayiou"],
        ),
    )


def _section(name: str, charts: tuple[Chart, ...]) -> "Section":
    from wandb_workspaces import workspaces as ws

    columns = 2 if all(chart.kind in ONE_COLUMN for chart in charts) else 3
    return ws.Section(
        name=name,
        panels=[_panel(chart) for chart in charts],
        is_open=True,
        layout_settings=ws.SectionLayoutSettings(columns=columns, rows=3),
    )


def _panel(chart: Chart) -> Any:
    from wandb_workspaces.reports.v2 import interface as panels

    keys: list[Any] = list(chart.keys)
    if chart.kind == "bars":
        return panels.BarPlot(title=chart.title, metrics=keys, groupby=panels.Config("row"), max_runs_to_show=40)
    if chart.kind == "lines":
        return panels.LinePlot(title=chart.title, x=STEP, y=keys, groupby=panels.Config("row"))
    if chart.kind == "scatter":
        return panels.ScatterPlot(title=chart.title, x=keys[0], y=keys[1])
    if chart.kind == "table":
        return panels.WeavePanelSummaryTable(table_name=keys[0])
    return panels.MediaBrowser(title=chart.title, media_keys=keys, num_columns=3)


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Save the dashboard to W&B and print its address."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--entity", help="W&B user or team (default: that of the login)")
    parser.add_argument("--project", default="omniocc", help="W&B project")
    options = parser.parse_args(arguments)
    if not logged_in():
        raise UserError("not saved, since the dashboard lives on a W&B server: run `wandb login` or set WANDB_API_KEY")
    import wandb

    entity = options.entity or wandb.Api().default_entity
    if entity is None:
        raise UserError("this login has no default entity: name the W&B user or team with --entity")
    board = workspace(entity, options.project)
    board.save()
    print(f"dashboard {board.url}")


if __name__ == "__main__":
    main()
