"""The documentation names files, folders and code that exist."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import yaml

from omniocc.classes import CLASSES

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "omniocc"
PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
PAGES = [page for page in PAGES if "_build" not in page.parts and "runs" not in page.parts]

EXAMPLES = {
    "src/omniocc/model/refiner/my_refiner.py",
    "conf/model/refiner/my_refiner.yaml",
    "tests/model/refiner/test_my_refiner.py",
    "omniocc.model.refiner.my_refiner",
    "omniocc.model.refiner.my_refiner.MyRefiner",
    "sweeps/my_lifters.yaml",
}
"""What a reader is to write, as is everything below `mylib/`."""

FILE = re.compile(r"(?<![\w/.<>:-])(?:src|conf|docs|tests|tools|sweeps|notebooks|\.github)(?:/[\w*][\w.*-]*)+")
IN_PACKAGE = re.compile(r"(?<![\w/.<>:-])[a-z_]+(?:/[a-z_]\w*)+\.py\b")
DOTTED = re.compile(r"\bomniocc(?:\.\w+)+")
IMPORT = re.compile(r"^(?:>>> )?from (omniocc[\w.]*) import ([\w, ]+)", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
COMMAND = re.compile(r"^(?:    )?python src/train\.py(.*?)(?: +#.*)?$", re.MULTILINE)
ROW = re.compile(r"^\| (?!\*\*|task|---)(.+?) \| (.+?) \|(.*?)\|$", re.MULTILINE)
CODE = re.compile(r"`([^`]+)`")


def by_page(pattern: re.Pattern[str], pages: list[Path] = PAGES) -> list[tuple[str, str]]:
    """Return page and match, without what a reader is to write."""
    found = [(str(page.relative_to(ROOT)), match) for page in pages for match in pattern.findall(page.read_text())]
    names = [(page, match.rstrip(".")) for page, match in found]
    return [(page, name) for page, name in names if name not in EXAMPLES and not name.startswith("mylib/")]


def is_there(path: str, base: Path = ROOT) -> bool:
    """Return whether a path exists; `*` stands for any name."""
    return any(base.glob(path)) if "*" in path else (base / path).exists()


def test_no_page_has_marks_of_a_merge():
    marked = [page.name for page in PAGES if re.search("^(<<<<<<<|>>>>>>>) ", page.read_text(), re.MULTILINE)]
    assert not marked


def test_paths_exist():
    named = by_page(FILE)
    assert len(named) > 100
    assert [entry for entry in named if not is_there(entry[1])] == []


def test_short_paths_are_the_end_of_a_path_in_the_package():
    named = [entry for entry in by_page(IN_PACKAGE) if not FILE.match(entry[1])]
    assert [entry for entry in named if not any(PACKAGE.parent.rglob(entry[1]))] == []


def test_links_lead_somewhere():
    links = [(page, link) for page, link in by_page(LINK) if "://" not in link]
    assert len(links) > 50
    assert [entry for entry in links if not ((ROOT / entry[0]).parent / entry[1]).exists()] == []


def exists(name: str) -> bool:
    """Return whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith(("omniocc", "omniworld", "rayiou")):
                raise
            continue
        for part in parts[end:]:
            annotated = part in getattr(found, "__annotations__", {})
            if not annotated and not hasattr(found, part):
                return False
            found = getattr(found, part, None)
        return True
    return False


def test_names_in_code_exist():
    named = sorted({name for _, name in by_page(DOTTED)})
    assert len(named) > 30
    assert [name for name in named if not exists(name)] == []


def test_imports_of_examples_work():
    wanted = [(page, f"{module}.{name.strip()}") for page, (module, names) in imports() for name in names.split(",")]
    assert [entry for entry in wanted if entry[1] not in EXAMPLES and not exists(entry[1])] == []


def imports() -> list[tuple[str, tuple[str, str]]]:
    """Return page, module and names of every import in an example."""
    return [(page.name, found) for page in PAGES for found in IMPORT.findall(page.read_text())]


def commands() -> list[str]:
    """Return the overrides of every training command that stands complete on a line of its own."""
    pages = [page for page in PAGES if page.name in ("README.md", "swap_a_part.md", "own_data.md", "cluster.md")]
    found = {line.strip() for page in pages for line in COMMAND.findall(page.read_text())}
    return sorted(line for line in found if not re.search(r"<|--|my_|/data/|\.\.\.", line))


@pytest.mark.parametrize("overrides", commands())
def test_commands_compose(overrides, composed):
    assert composed(*shlex.split(overrides)).model


def test_where_is_it_names_what_the_file_holds():
    table = (ROOT / "docs" / "where_is_it.md").read_text()
    rows = ROW.findall(table)
    assert len(rows) > 40
    missing = []
    for task, where, words in rows:
        files = [ROOT / path for path in CODE.findall(where) if (ROOT / path).is_file()]
        texts = "\n".join(path.read_text() for path in files)
        missing += [(task, word) for word in CODE.findall(words) if word not in texts]
    assert missing == []


def test_every_package_with_public_names_is_in_the_reference():
    reference = "\n".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    public = [path.parent for path in PACKAGE.rglob("__init__.py") if "__all__" in path.read_text()]
    names = [".".join(path.relative_to(PACKAGE.parent).parts) for path in public]
    assert len(names) > 10
    assert [name for name in sorted(names) if f"automodule:: {name}\n" not in reference] == []


def size_row(preset: str) -> str:
    """Return the row of a preset in the table of sizes of `docs/dataset.md`."""
    sizes = yaml.safe_load((ROOT / "conf" / "preset" / f"{preset}.yaml").read_text())
    data, grids = sizes["data"]["virtual"], sizes["geometry"]
    shapes = [" x ".join(map(str, grids[grid]["shape"])) for grid in ("cylinder", "cuboid")]
    image = " x ".join(map(str, data["image_size"]))
    streets = ", ".join(str(data[f"{split}_scenes"]) for split in ("train", "val", "test"))
    cells = [f"`{preset}`", *shapes, image, streets, data["frames_per_scene"], data["frame_interval_s"]]
    return f"| {' | '.join(map(str, cells))} |"


def test_the_sizes_and_classes_of_the_data_page_are_those_of_the_code():
    text = (ROOT / "docs" / "dataset.md").read_text()
    assert [row for row in map(size_row, ("smoke", "tiny", "small", "paper")) if row not in text] == []
    assert [row for row in CLASSES if f"| {row.id} | {row.name} |" not in text] == []


def test_the_results_in_the_readme_are_those_of_their_page():
    """`python src/report.py --runs docs/results/runs.tar.xz --docs docs/results` writes both; see `test_results.py`."""
    marks = re.compile(
        r"^<!-- Results, written by .*? -->$.*?^<!-- End of the results\. -->$", re.MULTILINE | re.DOTALL
    )
    (readme,), (page,) = (marks.findall((ROOT / path).read_text()) for path in ("README.md", "docs/results/index.md"))
    assert readme == page
    assert readme.count("\n| I") + readme.count("\n| V") >= 17
