"""The W&B dashboard as code: `python -m omniocc.report.wandb.dashboard` saves it to a project.

Everything it shows is logged by the runs themselves; a test compares the keys of its charts with those of a run.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from omniocc.errors import UserError, installing
from omniocc.report.runs import read_runs
from omniocc.runs.script import lines_not_tracebacks
from omniocc.runs.table import band_names, class_names
from omniocc.runs.wandb.loggers import check_login

if TYPE_CHECKING:
    from wandb_workspaces.workspaces import Workspace

STEP = "trainer/global_step"
SLOTS = ("depth", "sketch", "geometry", "lifter", "temporal", "refiner")
"""Slots whose options are columns of the list of runs."""


class Chart(NamedTuple):
    """One panel.

    Attributes:
        kind: bars and scatter show test figures, lines training curves.
        title: above the panel.
        keys: keys of what is drawn; of a scatter first x, then y.
    """

    kind: Literal["bars", "lines", "scatter", "media", "table"]
    title: str
    keys: tuple[str, ...]


def each(key: str, parts: Sequence[str]) -> tuple[str, ...]:
    """Return the key with `{}` replaced by each part."""
    return tuple(key.format(part) for part in parts)


def sections(metrics: Mapping[str, float]) -> dict[str, tuple[Chart, ...]]:
    """Return the charts of the dashboard by section, for the classes and distance bands of a finished run's figures."""
    classes, bands = class_names(metrics), band_names(metrics)
    return {
        "compare rows": (
            Chart("bars", "voxel RayIoU", ("test/rayiou",)),
            Chart("bars", "voxel RayIoU by threshold, m", each("test/rayiou@{}", ("1", "2", "4"))),
            Chart("bars", "surface RayIoU", ("test/lidar/rayiou",)),
            Chart("bars", "voxel IoU and mIoU", ("test/voxel/iou", "test/voxel/miou")),
            Chart("bars", "baseline without images: voxel RayIoU", ("prior/rayiou",)),
            Chart("bars", "upper bound, the true voxels: surface RayIoU", ("label/lidar/rayiou",)),
            Chart("lines", "voxel RayIoU on validation scenes", ("val/rayiou",)),
            Chart("lines", "training loss", ("train/loss",)),
        ),
        "by range": (
            Chart("bars", "voxel RayIoU by range, m", each("test/rayiou_{}", bands)),
            Chart("bars", "surface RayIoU by range, m", each("test/lidar/rayiou_{}", bands)),
            Chart("lines", "voxel RayIoU on validation scenes by range, m", each("val/rayiou_{}", bands)),
            Chart("table", "scores by range, m", ("tables/by_range",)),
        ),
        "by class": (
            Chart("bars", "voxel RayIoU by class", each("test/rayiou/{}", classes)),
            Chart("bars", "surface RayIoU by class", each("test/lidar/rayiou/{}", classes)),
            Chart("bars", "voxel IoU by class", each("test/voxel/iou/{}", classes)),
            Chart("table", "scores by class", ("tables/by_class",)),
        ),
        "depth and sketch": (
            Chart("bars", "depth: mean absolute error, m", each("test/depth/mae_{}", bands)),
            Chart("bars", "depth: mean relative error (AbsRel)", each("test/depth/absrel_{}", bands)),
            Chart("bars", "sketch: recall of occupied voxels", each("test/sketch/recall_{}", bands)),
            Chart("bars", "sketch: precision of candidates", each("test/sketch/precision_{}", bands)),
            Chart("scatter", "voxel RayIoU against fraction of candidates", ("test/sketch/fraction", "test/rayiou")),
            Chart(
                "scatter",
                "sketch: recall against fraction of candidates",
                ("test/sketch/fraction", "test/sketch/recall"),
            ),
        ),
        "images": (
            Chart("media", "truth beside prediction", ("test/voxels",)),
            Chart("media", "predicted voxels on the camera images", ("test/cameras",)),
            Chart("media", "from above: truth, prediction, differences", ("test/bev",)),
            Chart("media", "true voxels, to turn", ("test/points_truth",)),
            Chart("media", "predicted voxels, to turn", ("test/points_prediction",)),
            Chart("media", "depth: panoramas of range", ("test/erp",)),
            Chart("media", "depth: ranges on the camera images", ("test/depth",)),
            Chart("media", "sketch: candidates from above", ("test/sketch",)),
            Chart("media", "a validation frame during training", ("val/voxels",)),
        ),
    }


ONE_COLUMN = ("table", "media")


def workspace(entity: str, project: str, charts: Mapping[str, Sequence[Chart]]) -> "Workspace":
    """Return the dashboard, not saved yet, with runs grouped by job type (stage) and row: bars are means over seeds.

    Raises:
        UserError: when the extra `dashboard` is not installed.
    """
    try:
        from wandb_workspaces import workspaces as ws
    except ImportError as error:
        raise UserError(f"the dashboard needs wandb-workspaces: {installing('dashboard')}") from error
    return ws.Workspace(
        entity=entity,
        project=project,
        name="OmniDepth-Occ",
        sections=[
            ws.Section(
                name=name,
                panels=[_panel(chart) for chart in part],
                is_open=True,
                layout_settings=ws.SectionLayoutSettings(
                    columns=2 if all(chart.kind in ONE_COLUMN for chart in part) else 3, rows=3
                ),
            )
            for name, part in charts.items()
        ],
        settings=ws.WorkspaceSettings(x_axis=STEP, max_runs=40),
        runset_settings=ws.RunsetSettings(
            groupby=[ws.Metric("JobType"), ws.Config("row")],
            pinned_columns=[
                *("config:preset.name", "config:seed", "summary:test/rayiou", "summary:test/lidar/rayiou"),
                *(f"config:slots.{slot}" for slot in SLOTS),
            ],
        ),
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
    parser.add_argument(
        "--runs", type=Path, default=Path("runs"), help="folder of runs, whose classes and bands are shown"
    )
    options = parser.parse_args(arguments)
    check_login("not saved, since the dashboard lives on a W&B server")
    import wandb

    entity = options.entity or wandb.Api().default_entity
    if entity is None:
        raise UserError("this login has no default entity: name the W&B user or team with --entity")
    best, *_ = read_runs(options.runs)
    board = workspace(entity, options.project, sections(best.metrics))
    try:
        board.save()
    except Exception as error:  # the kinds of W&B's errors are no part of its public interface
        raise UserError(f"the W&B server did not save the dashboard to {entity}/{options.project}: {error}") from error
    print(f"dashboard {board.url}")


if __name__ == "__main__":
    main()
