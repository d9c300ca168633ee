"""Names of scenes, classes, rows and runs come from files: in a page they are texts, whatever they hold."""

from html.parser import HTMLParser
from pathlib import Path

from omniocc.report.html import render
from omniocc.report.plots import as_svg

EVIL = """</script></style><img src=x onerror="alert(1)">'&"""


class Tags(HTMLParser):
    """Collects elements and texts of a page."""

    def __init__(self, page: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.texts.append(data)


def check_inert(page: str) -> Tags:
    found = Tags(page)
    for tag, attributes in found.tags:
        assert tag != "img"
        assert not [name for name in attributes if name.startswith("on")]
    assert sum(tag == "script" for tag, _ in found.tags) <= 1
    return found


def test_names_on_the_page_of_a_dataset_cannot_end_its_script():
    scene = {"name": EVIL, "theme": EVIL, "cameras": [EVIL]}
    page = render("dataset.html.j2", {"content": {"scenes": [scene], "classes": [{"name": EVIL, "rgb": [0, 0, 0]}]}})
    without_own = page.replace('<img id="', '<i id="')
    assert without_own != page
    check_inert(without_own)
    script = page[page.index("<script>") : page.index("</script>")]
    assert "\\u003c/script\\u003e" in script
    for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert way not in script


def test_names_on_the_page_of_a_sweep_are_texts():
    table = {"note": EVIL, "cells": ([EVIL], [[EVIL]]), "files": True}
    sections = [{"kind": "text_table", "name": EVIL, "title": EVIL, **table}]
    content = {"remarks": [EVIL], "setting": EVIL, "others": {EVIL: EVIL}, "facts": {EVIL: EVIL}, "sections": sections}
    found = check_inert(render("page.html.j2", content))
    assert found.texts.count(EVIL) >= 7


def test_the_title_of_a_plot_is_a_text():
    from matplotlib.figure import Figure

    (svg, attributes), *_ = check_inert(as_svg(Figure(), "a", EVIL)[1]).tags
    assert (svg, attributes["aria-label"]) == ("svg", EVIL)


def test_nothing_turns_escaping_off():
    templates = (Path(__file__).parents[2] / "src" / "omniocc").rglob("*.j2")
    for template in templates:
        text = template.read_text()
        assert "| safe" not in text, template
        assert "|safe" not in text, template
        assert "autoescape" not in text, template
