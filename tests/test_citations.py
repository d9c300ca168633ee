"""Sections of the paper that docstrings, configuration and docs cite."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SECTIONS = {
    "I": "",  # introduction, with the figure of the cylindrical voxel
    "II": "ABC",  # related work: datasets, representations, prediction
    "III": "",  # dataset
    "IV": "ABCDEFG",  # method: architecture, sketch, coloring, semantic head, temporal fusion, refine module, loss
    "V": "ABC",  # experiment: setup, result, ablation
    "VI": "",  # conclusion
}
OF_SLOT = {
    "depth": "IV-B",
    "sketch": "IV-B",
    "lifter": "IV-C",
    "semantic_head": "IV-D",
    "temporal": "IV-E",
    "refiner": "IV-F",
}
CITATION = re.compile(r"section ([IVX]+)(?:-([A-Z]))?\b")
FILES = [
    path
    for folder, ending in (("src", "py"), ("conf", "yaml"), ("docs", "md"), ("tests", "py"))
    for path in sorted((ROOT / folder).rglob(f"*.{ending}"))
]


def citations(path: Path) -> list[tuple[str, str]]:
    """Return section and letter of every citation in a file."""
    return CITATION.findall(path.read_text(encoding="utf-8"))


def test_cited_sections_are_in_the_paper():
    cited = [(path, section, letter) for path in FILES for section, letter in citations(path)]
    assert len(cited) >= 10
    assert [row for row in cited if row[1] not in SECTIONS or (row[2] and row[2] not in SECTIONS[row[1]])] == []


@pytest.mark.parametrize("slot", OF_SLOT)
def test_slots_cite_the_section_that_describes_them(slot):
    files = [path for path in FILES if path.parent.name == slot and path.parent.parent.name == "model"]
    cited = {f"{section}-{letter}" for path in files for section, letter in citations(path)}
    assert cited == {OF_SLOT[slot]}
