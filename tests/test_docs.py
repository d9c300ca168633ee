"""The documentation names files, folders and code that exist."""

import importlib
import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml

from omniocc.classes import CLASSES
from omniocc.runs.weights import SHIPPED, shipped

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "omniocc"
PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
PAGES = [page for page in PAGES if not {"_build", "runs", "report"} & set(page.parts)]  # are made

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
PICTURE = re.compile(r"!\[[^\]]*\]\([./\w]*pictures/([\w.]+)\)(.{,500})", re.DOTALL)
WORDS_IN_ALL, README_LINES, LARGEST_PICTURE = 45_000, 120, 4_000_000


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


def test_commands_on_datasets_name_their_root():
    needs = {path.stem for path in (ROOT / "conf" / "data").glob("*.yaml") if "root: ???" in path.read_text()}
    used = re.compile(r"python src/(?:train|evaluate|check)\.py[^`\n]*\bdata=(\w+)([^`\n]*)")
    found = [
        (page.name, name, rest) for page in PAGES for name, rest in used.findall(page.read_text()) if name in needs
    ]
    assert len(found) > 5
    assert [entry for entry in found if "data.source.root=" not in entry[2] and "..." not in entry[2]] == []


def test_upper_bounds_that_pages_quote_are_those_of_their_table():
    table = (ROOT / "docs" / "results" / "appendix" / "costs.md").read_text()
    ((cylinder,), (cuboid,)) = (
        re.findall(rf"^\| {grid} .*? (0\.\d+) \|$", table, re.MULTILINE) for grid in ("cylinder", "cuboid")
    )
    quoted = {
        "docs/how_to/troubleshooting.md": f"true voxels score {cylinder} at",
        "docs/results/appendix/breakdowns.md": f"true voxels score {cylinder} (cylinder) and {cuboid} (cuboid)",
    }
    assert [path for path, text in quoted.items() if text not in (ROOT / path).read_text()] == []


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


WORDS = {
    r"\b(by|against|on) (its|their) own voxels": "voxel RayIoU",
    r"\b(by|against) LiDAR rays|RayIoU, LiDAR": "surface RayIoU",
    r"\bjudge[sd]?\b": "metric, score",
    r"\blast stage\b": "occupancy stage",
    r"\bin proportion\b": "rescaled",
    r"\bchain\b": "pipeline",
    r"\b(an?|the|what|its) share of\b|\bshares of\b": "fraction",
    r"\bmoments?\b": "frame, time step",
    r"\b(an?|the|one|per|each|every) drive\b": "sequence",
    r"\(control\)|\bthe control\b": "baseline",
    r"\b(test|validation|training|unseen|drawn|rendered|\d+|these|other|whole) streets?\b": "scene",
    r"\bfigures?\b": "number, score",
    r"\bpictures?\b": "image",
    r"\bin small\b": "at small scale",
}
"""Words of this project's own, and the field's terms for them."""
HISTORY = re.compile(
    r"\b(no longer|formerly|previously|used to|until now|meanwhile|was overlooked|were run again|when (it|this) was "
    r"written|since then|has become|not yet)\b"
)
BARE_NUMBER = re.compile(r"(?<![\w.)\]/*:])\.\d")
SCORE = re.compile(r"(?<![\w.])\d\.\d{3}(?![\w.]*\d)")
COMMIT = re.compile(r"\bcommit `?[0-9a-f]{7,}")
LONGEST_WORDS, MOST_SCORES, MOST_SCORES_OF_PARAGRAPH = 40, 2, 4


class Paragraph(NamedTuple):
    """A paragraph or a point of a list without code and links; whether it stands below a table."""

    text: str
    below_table: bool = False

    @property
    def sentences(self) -> list[str]:
        return re.split(r"(?<=[.!?])[*)]*\s+(?![a-z])", self.text)


def without_code(text: str) -> str:
    """Return Markdown without comments, blocks of code, code in lines, targets of links, and quoted words."""
    text = re.sub(r"^```.*?^```$|<!--.*?-->", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"(?<=\n\n)( {4}[^\n]*\n)+", "", text)
    return re.sub(r"(?<!\w)'[\w ]+'", "X", re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "`", text)))


def paragraphs(text: str) -> list[Paragraph]:
    """Return the prose of a page, without headings and tables."""
    found, lines, below_table = [], [], False
    for line in [*without_code(text).splitlines(), ""]:
        starts = re.match(r"\s*([*+-]|\d+\.) ", line)
        if lines and (starts or not line.strip() or line.lstrip().startswith(("|", "#"))):
            found.append(Paragraph(" ".join(lines), below_table))
            lines, below_table = [], False
        if line.lstrip().startswith(("|", "#")):
            below_table = line.lstrip().startswith("|")
        elif line.strip():
            lines.append(line.strip())
    return found


def long_sentences(text: str) -> list[str]:
    return [one for each in paragraphs(text) for one in each.sentences if len(one.split()) > LONGEST_WORDS]


def crowded(text: str) -> list[str]:
    """Return sentences and paragraphs with too many scores: numbers of three decimals, so dates and sizes pass."""
    limits = ((MOST_SCORES, lambda each: each.sentences), (MOST_SCORES_OF_PARAGRAPH, lambda each: [each.text]))
    parts = [(one, most) for each in paragraphs(text) for most, split in limits for one in split(each)]
    return [one for one, most in parts if len(SCORE.findall(one)) > most]


def bare_numbers(text: str) -> list[str]:
    return [line for line in without_code(text).splitlines() if BARE_NUMBER.search(line)]


def commits_in_sentences(text: str) -> list[str]:
    """Return paragraphs that name a commit neither below a table nor in brackets."""
    inside = [(each, re.sub(r"\([^()]*\)", "", each.text)) for each in paragraphs(text) if not each.below_table]
    return [each.text for each, rest in inside if COMMIT.search(rest)]


def old_words(text: str) -> list[str]:
    prose = without_code(text)
    return [f"{found[0]} -> {new}" for old, new in WORDS.items() for found in re.finditer(old, prose)]


def history(text: str) -> list[str]:
    return [found[0] for found in HISTORY.finditer(without_code(text))]


RULES = (long_sentences, crowded, bare_numbers, commits_in_sentences, old_words)
"""Rules of CONTRIBUTING.md, section Language; each returns what breaks it."""
BREAKS = {
    long_sentences: "A sentence. " + "word " * 41 + "ends.",
    crowded: "It scores 0.356 here, 0.470 there and 0.401 elsewhere.",
    bare_numbers: "It scores .356.\n\n| a | -.011 |",
    commits_in_sentences: "Since commit 3c8a9a5c it is better.",
    old_words: "On 32 test streets the last stage scores more.",
    history: "It is no longer so.",
}
KEEPS = """
It scores 0.356 ± 0.003 in version 1.2.345 (commit 3c8a9a5c), `lr=.003`. One more sentence: 0.470, 0.401.

| a | 0.111 | 0.222 | 0.333 |
|---|---|---|---|

Commit 3c8a9a5c, seed 0; `python src/train.py`.

    python src/train.py optimizer.learning_rate=.003
"""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_language(rule, page):
    assert rule(page.read_text()) == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "results").rglob("*.md")), ids=lambda page: page.stem)
def test_results_have_no_history(page):
    assert page.stem == "deviations" or history(page.read_text()) == []


@pytest.mark.parametrize("rule", BREAKS, ids=lambda rule: rule.__name__)
def test_rules_of_language_find_what_breaks_them(rule):
    assert rule(BREAKS[rule])
    assert rule(KEEPS) == []


def test_documentation_has_at_most_as_many_words_as_its_budget():
    pages = [page for page in PAGES if page.name != "SECURITY.md" and "appendix" not in page.parts]
    assert sum(len(page.read_text().split()) for page in pages) <= WORDS_IN_ALL
    assert len((ROOT / "README.md").read_text().splitlines()) <= README_LINES


def test_every_picture_is_used_and_names_the_command_that_makes_it():
    shown = [(page, name, rest) for page in PAGES for name, rest in PICTURE.findall(page.read_text())]
    assert len(shown) >= 10
    files = list((ROOT / "docs" / "pictures").iterdir())
    assert {name for _, name, _ in shown} == {path.name for path in files}
    assert max(path.stat().st_size for path in files) < LARGEST_PICTURE
    told = re.compile(r"`(make pictures|python tools/)|drawn by hand")
    assert [(page.name, name) for page, name, rest in shown if not told.search(rest)] == []


def test_weights_in_the_readme_are_those_of_their_page_and_of_the_cards():
    """`python tools/model_zoo.py` writes both."""
    marks = re.compile(
        r"^<!-- Weights, written by .*? -->$.*?^<!-- End of the weights\. -->$", re.MULTILINE | re.DOTALL
    )
    (readme,), (page,) = (marks.findall((ROOT / path).read_text()) for path in ("README.md", "docs/weights.md"))
    assert readme.replace("docs/weights.md#", "weights.md#") == page
    for name in shipped():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| [`{name}`]")]
        scores = re.findall(
            r"^\| voxel RayIoU(?:, [\d.-]+ m)? \| (0\.\d{3}) \|$", (SHIPPED / f"{name}.md").read_text(), re.MULTILINE
        )
        assert [score for score in scores if f"| {score} |" not in row] == []
