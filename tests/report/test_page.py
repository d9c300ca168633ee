"""The page on a sweep is complete and needs no other file."""

import base64
import csv
import importlib.util
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from fake_sweep import report

from omniocc.report.sweep import read_sweeps
from omniocc.runs.robustness import UNDISTURBED, PartScores, Robustness, save_robustness

ROOT = Path(__file__).parents[2]


class Outline(HTMLParser):
    """Ids, links, images, text and whether every element is closed."""

    def __init__(self):
        super().__init__()
        self.ids, self.links, self.sources, self.text, self.open = [], [], [], [], []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found["href"]] if tag == "a" else []
        self.sources += [found["src"]] if "src" in found else []
        assert tag not in ("script", "iframe", "link")
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def output(runs, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "made here"
    report("--runs", str(runs), "--output", str(folder))
    return folder


@pytest.fixture(scope="module")
def outline(output) -> Outline:
    parser = Outline()
    parser.feed((output / "index.html").read_text("utf-8"))
    parser.close()
    return parser


def test_the_page_is_complete_and_every_link_has_a_target(output, outline):
    assert outline.open == []
    assert len(outline.ids) == len(set(outline.ids))
    targets = [link[1:] for link in outline.links if link.startswith("#")]
    files = [output / unquote(link.split("#")[0]) for link in outline.links if not link.startswith("#")]
    assert len(targets) > 20
    assert set(map(unquote, targets)) <= set(outline.ids)
    assert len(files) > 30
    assert [path for path in files if not path.exists()] == []


def test_the_page_needs_no_other_file_and_every_image_decodes(output, outline):
    page = (output / "index.html").read_text("utf-8")
    assert "http" not in page
    assert "@import" not in page
    assert len(outline.sources) == 1 + 2 * 2 + 4 * 3
    for source in outline.sources:
        kind, data = source.split(",", 1)
        assert kind == "data:image/webp;base64"
        image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.std() > 5


def test_figures_lead_to_run_configuration_and_command(outline, runs):
    text = "".join(outline.text)
    assert "python src/train.py '+ablation=my <own>-00000001' seed=0 <&>" in text
    assert re.search(r"Not run: \d\d rows of the tables\.", text)
    assert "0.320 ± 0.020" in text
    assert "± is the standard error over seeds" in text
    assert "Table VII: " in text
    expected = [(runs / "ours-00000002" / name).resolve() for name in ("", "config.yaml", "metrics.json")]
    assert [
        str(path).split("/runs/")[1]
        for path in expected
        if not any(unquote(link).rstrip("/").endswith(str(path).split("/runs/")[1]) for link in outline.links)
    ] == []


def test_every_table_says_how_its_scores_were_counted(output, outline):
    text, markdown = "".join(outline.text), (output / "report.md").read_text("utf-8")
    sketch = "Voxel RayIoU: rays from the ego origin."
    both, representation = "Voxel RayIoU (cuboid): rays from given origins.", "Voxel RayIoU: rays from given origins."
    for line in (sketch, both, representation, "Surface RayIoU: rays of a LiDAR.", "IoU, mIoU: all cells."):
        assert line in text
        assert f"\n\n{line}\n" in markdown
    chapters = markdown.split("\n## ")
    for title, line in (("Table VI:", sketch), ("Baseline", both), ("Table VII:", representation)):
        (chapter,) = (part for part in chapters if part.startswith(title))
        assert line in chapter
    budget = next(part for part in chapters if part.startswith("Budget"))
    assert "RayIoU" not in budget
    assert f". {sketch} " in (output / "sketch.tex").read_text("utf-8").splitlines()[0]


def test_frames_lead_to_the_viewer_pages_of_runs_that_have_one(outline, runs):
    frames = sorted(path.name for path in (runs / "ours-00000001" / "images" / "parts").iterdir())
    found = [unquote(link) for link in outline.links if "view.html" in link]
    assert len(found) == 2 * len(frames)  # of five runs, two have a page
    for name, link in zip(frames, found[::2], strict=True):
        _, scene, frame = re.fullmatch(r"test-(\d+)-(.+)-(\d+)", name).groups()
        assert link.endswith(f"runs/ours-00000001/view.html#scene={scene}&frame={frame}")
    assert all("my <own>-00000001/view.html#" in link for link in found[1::2])


def test_a_newcomer_sees_own_rows_first_and_tables_without_a_run_are_folded(runs, tmp_path, monkeypatch):
    """Two rows: one of the sketch's table, and one of no table."""
    find_spec = importlib.util.find_spec  # plots take most of the time
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find_spec(name))
    for name in ("dense-00000001", "my <own>-00000001"):
        shutil.copytree(runs / name, tmp_path / "runs" / name)
    report("--runs", str(tmp_path / "runs"))
    page = (tmp_path / "runs" / "report" / "index.html").read_text("utf-8")
    before, *sections = page.split('<section class="card" id="')
    names = [section.partition('"')[0] for section in sections]
    assert (names[0], names[-1]) == ("runs", "waiting")
    assert "sketch" in names
    assert not {"comparison", "refine"} & set(names)
    for name in ("comparison", "refine"):
        command = f"python src/train.py --multirun +sweep={name} preset=tiny"
        assert re.search(rf'<details id="{name}"><summary>[^<]*<code>{re.escape(command)}</code>', sections[-1])
    sketch = sections[names.index("sketch")]
    assert sketch.index(">dense voxels<") < sketch.index(">omni depth<")
    assert not any(">not run<" in section for section in sections)
    assert before.count("bevdet") == 0
    markdown = (tmp_path / "runs" / "report" / "report.md").read_text("utf-8")
    assert "## Table V: " in markdown  # which has all tables


def test_claims_and_rows_that_have_not_run_are_counted(outline):
    text = "".join(outline.text)
    assert re.search(r"Not run and not shown: \d+ claims\.", text)
    assert re.search(r"Not run and not shown: \d+ rows\.", text)


def test_tables_and_plots_are_beside_the_page(output, capsys):
    tables = {path.stem for path in output.glob("*.tex")} & {path.stem for path in output.glob("*.csv")}
    assert tables == {
        "bets",
        "beyond",
        "classes",
        "comparison",
        "dataset",
        "distance",
        "disturbed",
        "equal_budget",
        "equal_steps",
        "interval",
        "lidar",
        "moving",
        "one_lidar",
        "origins",
        "places",
        "reasons",
        "refine",
        "representation",
        "rivals",
        "rivals_budget",
        "semantic_temporal",
        "sketch",
        "weather",
    }
    markdown = (output / "report.md").read_text("utf-8")
    claim = "| Sketch ahead of all voxels | Table VI | undecided (one seed only) | +0.120 | +0.036 | +0.025 | – |"
    assert claim in markdown
    assert "| OmniDepth-Occ (here) | – | ✓ |" in markdown
    assert markdown.index("## Table I: ") < markdown.index("## Table II: ")
    folder = unquote(markdown.split("- [dense-00000001](")[1].split("/)")[0])
    assert (output / folder / "config.yaml").exists()
    names = {path.name for path in (output / "plots").glob("*.svg")}
    assert names == {"class.svg", "ranking.svg", "range.svg", "candidates.svg", "training.svg"}
    assert all(ElementTree.parse(output / "plots" / name).getroot().tag.endswith("}svg") for name in names)


def test_thirty_lines_are_printed_at_most_and_all_tables_by_a_flag(runs, tmp_path, capsys, monkeypatch):
    """Of fourteen rows six have seeds that differ, and eight a run with another number of steps."""
    folder = tmp_path / "runs"
    for number in range(14):
        first, other = (shutil.copytree(runs / "my <own>-00000001", folder / f"row{number}-0000000{k}") for k in (1, 2))
        for path in (first, other):
            shutil.rmtree(path / "images")
        facts = json.loads((other / "metrics.json").read_text())
        more = {"seed": 1} if number < 6 else {"steps": 50 + number}
        (other / "metrics.json").write_text(json.dumps(facts | more))
        config = yaml.safe_load((other / "config.yaml").read_text()) | {"lr": 0.7}
        (other / "config.yaml").write_text(yaml.safe_dump(config))
    find_spec = importlib.util.find_spec  # plots take most of the time
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find_spec(name))
    report("--runs", str(folder))
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 30
    assert "| row0 | – | 2 | 0.250 ± 0.000 | 0.125 ± 0.000 |" in printed
    assert [line for line in printed if line.startswith("...")] == [
        "... and 4 more remarks",
        "... and 4 more rows",
        "... and 4 more settings",
    ]
    report("--runs", str(folder), "--all")
    assert (folder / "report" / "report.md").read_text().split("\n## Runs\n")[0].strip() in capsys.readouterr().out


def test_the_path_is_printed_also_for_an_unfinished_sweep(runs, tmp_path, capsys):
    part = tmp_path / "runs"
    (part / "mono-00000001" / "csv" / "version_0").mkdir(parents=True)
    (part / "mono-00000001" / "config.yaml").write_text("seed: 0\n")
    (part / "mono-00000001" / "csv" / "version_0" / "metrics.csv").write_text("step,train/loss\n19,8.0\n")
    (part / "dense-00000001").symlink_to(runs / "dense-00000001")
    report("--runs", str(part))
    assert capsys.readouterr().out.splitlines()[-1] == f"page    {part / 'report' / 'index.html'}"
    page = (part / "report" / "index.html").read_text("utf-8")
    assert "Not run: " in page
    assert "Begun, not finished: mono-00000001 (step 19)." in page


def test_the_tables_are_written_as_pages_of_the_documentation_and_csv(runs, tmp_path):
    docs = tmp_path / "docs" / "results"
    report("--runs", str(runs), "--output", str(tmp_path / "report"), "--docs", str(docs))
    assert {str(path.relative_to(docs)) for path in docs.rglob("*.md")} == {
        "appendix/breakdowns.md",
        "appendix/claims.md",
        "appendix/costs.md",
        "beyond.md",
        "index.md",
        "paper.md",
        "systems.md",
    }
    assert {"sketch.csv", "runs.csv", "claims.csv", "power.csv"} <= {path.name for path in (docs / "csv").iterdir()}
    generated, _, title, *lines = (docs / "paper.md").read_text("utf-8").splitlines()
    command = "python src/report.py --runs docs/results/runs.tar.xz --docs docs/results"
    assert generated == f"<!-- Written by `{command}`; do not edit. -->"
    assert title == "# The paper's tables, trained here"
    headings = [line.removeprefix("## ").partition(":")[0] for line in lines if line.startswith("## ")]
    tables = [f"Table {number}" for number in ("I", "II", "III", "IV", "V", "VI", "VII")]
    assert headings == [*tables, "How scores are counted"]
    assert not any("±" in line for line in lines)
    assert any(line.endswith("[sketch.csv](csv/sketch.csv).") for line in lines)
    (claim,) = (line for line in (docs / "appendix" / "claims.md").read_text("utf-8").splitlines() if "0.120" in line)
    assert claim.startswith("| Sketch ahead of all voxels |")
    records = csv.DictReader((docs / "csv" / "runs.csv").read_text("utf-8").splitlines())
    (own,) = (line for line in records if line["row"] == "my <own>")
    assert (own["seed"], own["steps"], own["minutes"], own["commit"]) == ("0", "40", "1.5", "abc")
    assert own["command"].startswith("python src/train.py")


def test_tests_under_disturbances_are_gathered_and_kept(runs, tmp_path):
    """Those of a run, and those of weights that have no run, on the page, as a page of the documentation, and kept."""
    folder, kept = tmp_path / "runs", tmp_path / "kept"
    shutil.copytree(runs, folder)
    places = {"ours-00000001": folder / "ours-00000001" / "robustness-best", "tiny": folder / "robustness-tiny"}
    for system, place in places.items():
        found = {UNDISTURBED: (UNDISTURBED, 0.5), "view_90_deg": ("view", 0.2 if system == "tiny" else 0.3)}
        parts = [
            PartScores(name, group, ["a", "b"], 2, 1.0, {"rayiou": score}, without={"rayiou": [score] * 2})
            for name, (group, score) in found.items()
        ]
        save_robustness(place, Robustness(system, {"setting": "one", "seed": 0}, parts))
    report("--runs", str(folder), "--keep", str(kept))
    assert len(list(kept.rglob("robustness.json"))) == 2
    for source in (folder, kept):
        docs, output = tmp_path / f"docs-{source.name}", tmp_path / f"report-{source.name}"
        report("--runs", str(source), "--output", str(output), "--docs", str(docs))
        text = (docs / "robustness.md").read_text("utf-8")
        assert "| mean of all kinds | **40.0** |" in text or "| mean of all kinds | 40.0 |" in text
        assert (docs / "csv" / "robustness.csv").read_text("utf-8").count("\n") == 5
        page = (output / "index.html").read_text("utf-8")
        assert 'id="robustness"' in page
        assert 'id="plot-robustness"' in page
        assert (output / "plots" / "robustness.svg").exists()


def test_without_runs_the_error_is_one_line(tmp_path):
    with pytest.raises(SystemExit) as caught:
        report("--runs", str(tmp_path))
    assert str(caught.value.code) == (
        f"{tmp_path} holds no finished run (metrics.json); train one: python src/train.py"
    )


def test_runs_of_other_lengths_have_pages_of_their_own_and_can_be_named_in_tables(runs, tmp_path, capsys):
    folder, tables = tmp_path / "runs", tmp_path / "sweeps"
    shutil.copytree(runs, folder)
    longer = folder / "ours-0000000a"
    shutil.copytree(runs / "ours-00000001", longer)
    facts = json.loads((longer / "metrics.json").read_text()) | {"steps": 4000, "run": longer.name}
    (longer / "metrics.json").write_text(json.dumps(facts))
    tables.mkdir()
    rows = "{ours: {title: ours}, ours@4000: {title: four times the steps}}"
    (tables / "long.yaml").write_text(
        f"title: Longer\norder_by: test/rayiou\ncolumns: {{test/rayiou: RayIoU}}\nrows: {rows}\n"
    )
    report("--runs", str(folder), "--sweeps", str(tables))
    (other,) = (path.parent for path in (folder / "report").glob("*/index.html"))
    assert "-4000-" in other.name
    assert f'href="{other.name}/index.html"' in (folder / "report" / "index.html").read_text()
    assert 'href="../index.html"' in (other / "index.html").read_text()
    for text in ((folder / "report" / "report.md").read_text(), (other / "report.md").read_text()):
        (line,) = (line for line in text.splitlines() if line.startswith("| four times the steps"))
        assert line.endswith("| 0.300 | 1 |")


def test_runs_on_other_data_are_not_taken_for_rows_of_a_table(runs, tmp_path):
    """The data of most runs have `@same` rows; on other data the row is not run, and seeds that differ are told."""
    folder, tables = tmp_path / "runs", tmp_path / "sweeps"
    for name in ("ours-00000001", "ours-00000002", "dense-00000001"):
        shutil.copytree(runs / name, folder / name)
    for name in ("ours-00000001", "ours-00000002"):
        other = shutil.copytree(runs / name, folder / name.replace("ours-0", "pinhole-1"))
        facts = json.loads((other / "metrics.json").read_text()) | {"data": "other", "run": other.name}
        (other / "metrics.json").write_text(json.dumps(facts))
    config = yaml.safe_load((other / "config.yaml").read_text())
    (other / "config.yaml").write_text(yaml.safe_dump(config | {"lr": 0.7}))
    tables.mkdir()
    rows = "{ours: {title: ours}, dense@same: {title: dense}, pinhole@same: {title: pinhole}}"
    (tables / "same.yaml").write_text(
        f"title: Same\norder_by: test/rayiou\ncolumns: {{test/rayiou: RayIoU}}\nrows: {rows}\n"
    )
    first, second = read_sweeps(folder, tables, ROOT / "conf", None)
    assert {"pinhole@40", "dense@40"} <= first.table_rows.keys()
    assert "Warning: the runs of row pinhole@40 differ in lr;" in " ".join(first.remarks)
    assert list(second.table_rows) == ["pinhole"]
    assert second.not_run == ["ours", "dense@40", "pinhole@40"]
