"""The paper's comparison of datasets, and the dataset that the runs used as its last row."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from omniocc.camera import Pinhole, Rig
from omniocc.data.source import SPLITS
from omniocc.data.store.files import list_folders
from omniocc.data.store.meta import DRAWN_RIGS
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.tables.formats import Part, csv_text, tabular
from omniocc.report.tables.paper import NUMERALS
from omniocc.runs.renamed import read_mapping
from omniocc.runs.table import Cells

MADE = {"rig", "frames_per_scene", *(f"{split}_scenes" for split in SPLITS)}
"""Arguments of sources whose scenes are made."""
Row = tuple[str, Sequence[bool | int]]


class DatasetTable(NamedTuple):
    """A table of datasets, as `sweeps/dataset.yaml` describes it.

    Attributes:
        name: name of the file.
        note: inconsistencies of the paper's figures.
        columns: title of each column, by key.
        rows: name and cells of each dataset; no cells where they are unknown.
        number: the table's number in the paper.
    """

    name: str
    title: str
    note: str
    columns: Mapping[str, str]
    rows: Sequence[Row]
    number: int = 0

    @property
    def heading(self) -> str:
        """Return the title, behind the number that it has in the paper."""
        return f"Table {NUMERALS[self.number]}: {self.title}" if self.number else self.title


def is_dataset_table(path: Path) -> bool:
    """Return whether a file of `sweeps/` is a table of datasets."""
    return read_mapping(path).get("kind") == "datasets"


def load_dataset_table(path: Path) -> DatasetTable:
    """Return the table that a file describes.

    Raises:
        UserError: if a key is missing, or a row has another number of cells than there are columns.
    """
    content = read_mapping(path)
    try:
        columns = content["columns"]
        rows = [(f"{row['title']} (paper)", row["paper"]) for row in content["rows"].values()]
        table = DatasetTable(path.stem, content["title"], content["note"], columns, rows, content.get("number", 0))
    except (AttributeError, KeyError, TypeError) as error:
        raise UserError(f"{path} is not a table of datasets: {error}; see sweeps/dataset.yaml") from error
    for key, (_, cells) in zip(content["rows"], rows, strict=True):
        if len(cells) != len(columns):
            raise UserError(f"{path}: row {key} has {len(cells)} cells for {len(columns)} columns")
    return table


def with_records(table: DatasetTable, runs: Sequence[FinishedRun]) -> DatasetTable:
    """Return the table with a row for the dataset of runs, as their configurations describe it.

    It has the frames of the first run, and the cameras of all runs. In the virtual world every pixel has class and
    range, and points from which any grid is filled.
    """
    sources = [_source(run) for run in runs]
    made = [source for source in sources if all(source.get(key) is not None for key in MADE)]
    if not made or made[0] is not sources[0]:
        return table
    names = dict.fromkeys(source["rig"] for source in made)
    pinhole = {pinhole for name in names if name not in DRAWN_RIGS for pinhole in kinds_of_cameras(name)}
    frames = sum(made[0][f"{split}_scenes"] for split in SPLITS) * made[0]["frames_per_scene"]
    cells = [True in pinhole, False in pinhole, True, True, True, frames]
    return table._replace(rows=[*table.rows, ("OmniDepth-Occ (here)", cells)])


@cache
def kinds_of_cameras(rig: str) -> frozenset[bool]:
    """Return a set: with True if the rig has pinholes, with False if it has others; empty if it cannot be read."""
    try:
        return frozenset(isinstance(camera, Pinhole) for camera in Rig.load(rig).cameras)
    except (ValueError, OSError):  # its file may be on the machine of the run alone
        return frozenset()


def with_folders(table: DatasetTable, folders: Sequence[Path]) -> DatasetTable:
    """Return the table with a row for each folder of recorded scenes; raise UserError for one without scenes."""
    rows = []
    for folder in folders:
        scenes = [SceneReader(folder / name) for name in list_folders(str(folder), META)] if folder.is_dir() else []
        if not scenes:
            raise UserError(f"{folder} holds no recorded scenes; give a folder that record.py or render.py wrote")
        _, *cells = own_row(scenes, [None])
        rows.append((folder.name, cells))
    return table._replace(rows=[*table.rows, *rows])


def own_row(scenes: Sequence[SceneReader], twins: Sequence[SceneReader | None]) -> tuple[Any, ...]:
    """Return our row of the paper's Table I; voxels of any grid can be voted from recorded points."""
    members = set.intersection(*(set(scene.index.members) for scene in scenes))
    voxels, dense = "points.zst" in members, {"semantic0.zst", "range0.zst"} <= members
    cameras = [camera for scene in (*scenes, *filter(None, twins)) for camera in scene.rig.cameras]
    pinhole = any(isinstance(camera, Pinhole) for camera in cameras)
    fisheye = any(not isinstance(camera, Pinhole) for camera in cameras)
    return ("This dataset", pinhole, fisheye, voxels, voxels, dense, sum(map(len, scenes)))


def facts_of_scenes(run: FinishedRun) -> str:
    """Return a sentence on how many scenes and frames each split of a run's data has; empty where they are recorded."""
    source = _source(run)
    if any(source.get(key) is None for key in (*MADE, "themes")):
        return ""
    frames = source["frames_per_scene"]
    parts = [
        f"{(scenes := source[f'{split}_scenes'])} scenes ({scenes * frames:,} frames) for {split}" for split in SPLITS
    ]
    return f"{', '.join(parts)}; {len(source['themes'])} kinds of places."


def _source(run: FinishedRun) -> Mapping[str, Any]:
    return run.config.get("data", {}).get("source") or {}


def dataset_cells(table: DatasetTable) -> Cells:
    """Return head and rows as text."""
    head = ["dataset", *table.columns.values()]
    return head, [[name, *(_cell(cells, k) for k in range(len(table.columns)))] for name, cells in table.rows]


def _cell(cells: Sequence[bool | int], column: int) -> str:
    if not cells:
        return "–"
    value = cells[column]
    return ("✓" if value else "–") if isinstance(value, bool) else f"{value:,}"


def dataset_part(table: DatasetTable) -> Part:
    """Return the table with its note."""
    return Part(table.name, table.heading, table.note, dataset_cells(table))


def dataset_csv(table: DatasetTable) -> str:
    """Return CSV with a line per dataset."""
    rows = [
        [name, *(("no", "yes")[cell] if isinstance(cell, bool) else cell for cell in cells)]
        for name, cells in table.rows
    ]
    return csv_text(["dataset", *table.columns.values()], rows)


def dataset_latex(table: DatasetTable) -> str:
    """Return a LaTeX tabular."""
    head, rows = dataset_cells(table)
    marked = [[cell.replace("✓", r"\checkmark").replace("–", "") for cell in row] for row in rows]
    return tabular(table.title, head, marked)
