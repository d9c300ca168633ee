"""Jobs of `--multirun +sweep=<table>`."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_automatic_config_search_path
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from omegaconf import OmegaConf

from omniocc.errors import UserError
from omniocc.runs.rows import jobs_of, known_rows, table_files

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"
MINE = """
title: Mine
seeds: [3, 4]
overrides: [preset=small]
rows:
  ours: {title: coloring}
  my_lifter: {title: pillar, overrides: [model/lifter=pillar]}
  my_lifter_long@3000: {title: pillar for longer, overrides: [model/lifter=pillar]}
"""


def jobs(*arguments: str, folder: Path | None = None) -> list[str]:
    path = create_automatic_config_search_path(None, None, str(CONF))
    if folder is not None:
        path.append("mylib", f"file://{folder}")
    loader = ConfigLoaderImpl(path)
    # Hydra imports its plug-ins anew when it looks for them, so that only the class it finds fits its base class
    sweeper: Any = Plugins.instance().class_name_to_class["hydra_plugins.table_sweeper.TableSweeper"](None)
    sweeper.config = OmegaConf.create(
        {"hydra": {"runtime": {"config_sources": [{"provider": "main", "path": str(CONF)}]}}}
    )
    sweeper.hydra_context = SimpleNamespace(config_loader=loader)
    parsed = OverridesParser.create(config_loader=loader).parse_overrides(list(arguments))
    (batch,) = sweeper.split_arguments(parsed, None)
    return [" ".join(job) for job in batch]


def test_every_row_of_a_table_is_trained_with_every_choice():
    assert jobs("+sweep=refine", "seed=0,1", "preset=small") == [
        f"+ablation={row} seed={seed} preset=small"
        for row in ("ours", "refine_attention", "wo_refine")
        for seed in (0, 1)
    ]


def test_the_tables_of_make_ablations_have_every_row_of_the_paper():
    (tables,) = (
        line.split("?=")[1].strip() for line in (ROOT / "Makefile").read_text().splitlines() if "SWEEP ?=" in line
    )
    assert sorted(jobs(f"+sweep={tables}")) == sorted(f"+ablation={path.stem}" for path in CONF.glob("ablation/*.yaml"))


def test_a_row_of_two_tables_is_trained_once():
    rows = ["ours", "refine_attention", "wo_refine", "wo_dilation", "mono", "dense", "random"]
    assert jobs("+sweep=refine,sketch") == [f"+ablation={row}" for row in rows]


def test_rows_of_other_tables_and_of_other_steps_are_found():
    assert "model=fosocc name=fosocc" in jobs("+sweep=bets")
    assert "model=fosocc name=fosocc_budget preset.stages.occupancy.max_steps=3100" in jobs("+sweep=rivals_budget")
    assert "+ablation=ours preset.stages.occupancy.max_steps=1000" in jobs("+sweep=rivals_budget")
    assert "+ablation=voxformer_pinhole" in jobs("+sweep=comparison"), "@same names no number of steps"


def test_a_table_of_ones_own_has_rows_overrides_and_seeds(tmp_path):
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "mine.yaml").write_text(MINE)
    small = "preset=small"
    rows = [
        f"{small} +ablation=ours",
        f"{small} model/lifter=pillar name=my_lifter",
        f"{small} model/lifter=pillar name=my_lifter_long preset.stages.occupancy.max_steps=3000",
    ]
    assert jobs("+sweep=mine", folder=tmp_path) == [f"{row} seed={seed}" for row in rows for seed in (3, 4)]
    assert jobs("+sweep=mine", "seed=0", folder=tmp_path) == [f"{row} seed=0" for row in rows]


def test_a_row_of_a_table_can_be_chosen():
    assert jobs("+sweep=rivals", "+row=fosocc") == ["model=fosocc name=fosocc"]
    rows = ["+ablation=ours", "+ablation=wo_refine", "+ablation=voxformer_pinhole"]
    assert jobs("+sweep=refine,comparison", "+row=voxformer_pinhole,ours,wo_refine") == rows


def test_without_a_table_the_sweeper_is_that_of_hydra():
    assert jobs("model/sketch=mono,dense", "seed=1") == ["model/sketch=mono seed=1", "model/sketch=dense seed=1"]


def test_mistakes_are_named():
    with pytest.raises(UserError, match=r"\+sweep=refin: there is no such table"):
        jobs("+sweep=refin,sketch")
    with pytest.raises(UserError, match=r"\+row=mono: there is no such row in refine; choose ours, refine_att"):
        jobs("+sweep=refine", "+row=mono")
    for name in ("power", "dataset"):
        with pytest.raises(UserError, match=rf"\+sweep={name}: this is no table of methods that can be trained"):
            jobs(f"+sweep={name}")
    with pytest.raises(UserError, match=r"row gone has no overrides.*conf/ablation"):
        jobs_of({"rows": {"gone": {"title": "a"}}}, {})


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("{extended: {overrides: [model=default]}}", "row extended has other overrides elsewhere"),
        ("{ours: {overrides: [model=extended]}}", "row ours has other overrides elsewhere"),
        ("[ours]", "rows has no mapping for every row"),
        ("{ours: null}", "rows has no mapping for every row"),
    ],
)
def test_a_table_that_contradicts_another_or_is_damaged_is_named(rows, message, tmp_path):
    (tmp_path / "mine.yaml").write_text(f"rows: {rows}")
    with pytest.raises(UserError, match=f"mine.yaml: {message}"):
        known_rows(CONF, [*table_files(CONF / "sweep"), tmp_path / "mine.yaml"])


@pytest.mark.parametrize("path", sorted((CONF / "sweep").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_rows_of_every_table_can_be_trained(path):
    table = OmegaConf.to_container(OmegaConf.load(path))
    if "order_by" in table:
        assert len(jobs_of(table, known_rows(CONF, table_files(CONF / "sweep")))) == len(table["rows"])
