"""A headless Chromium with software WebGL, and pages opened in it."""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from chromium import ARGUMENTS, find_chromium
from made_page import RUNS, write_made_page

from omniocc.errors import installing


class Opened(NamedTuple):
    """A page in a browser: `page` is Playwright's, `errors` are messages of its console, `requests` addresses."""

    page: "Page"  # type: ignore[name-defined]
    errors: list[str]
    requests: list[str]

    def js(self, code: str, value: object = None):
        return self.page.evaluate(code, value)

    def until(self, code: str, timeout_s: float = 30.0) -> None:
        """Wait until an expression is true; Playwright's own waiting needs `eval`, which the page's policy forbids."""
        deadline = time.monotonic() + timeout_s
        while not self.js(code):
            assert time.monotonic() < deadline, f"not true after {timeout_s} s: {code}"
            time.sleep(0.05)

    def drawn(self) -> None:
        """Wait until everything that was asked for is drawn."""
        self.js("omniocc.drawn()")


@pytest.fixture(scope="session")
def browser() -> Iterator["Browser"]:  # type: ignore[name-defined]
    path = find_chromium()
    if path is None:
        pytest.skip("no Chromium: apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason=f"no Playwright: {installing('browser')}")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> dict[int, Path]:
    """Return pages by number of runs: scenes alone, one run, two runs on different grids."""
    folder = tmp_path_factory.mktemp("pages")
    return {count: write_made_page(folder / f"{count}.html", RUNS[:count]) for count in range(3)}


@pytest.fixture
def open_page(browser) -> Iterator[Callable[..., Opened]]:
    """Return a function that opens a file; after the test no page may have reported an error or asked for anything."""
    opened: list[tuple[Path, Opened]] = []

    def open_file(path: Path, address: str = "", width: int = 1280, height: int = 800, **options: object) -> Opened:
        page = browser.new_context(viewport={"width": width, "height": height}, **options).new_page()
        found = Opened(page, [], [])
        opened.append((path, found))
        page.on("console", lambda message: found.errors.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: found.errors.append(f"error: {error}"))
        page.on("request", lambda request: found.requests.append(request.url))
        page.goto(path.as_uri() + address)
        found.drawn()
        return found

    yield open_file
    for path, found in opened:
        found.page.context.close()
        assert found.errors == []
        assert [url for url in found.requests if not url.startswith("data:")] == [path.as_uri()]
