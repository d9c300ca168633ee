"""The documentation's images of the page: `make pictures`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LARGEST_BYTES = 300_000
SHOTS = {
    "viewer_page": ({"width": 1440, "height": 1240}, "w", (2, 0.52, 0.62)),
    "viewer_page_dark": ({"width": 1440, "height": 640, "color_scheme": "dark"}, "wwca", None),
}
"""Size and scheme of the window, keys that are pressed, and the image and place in it that is clicked."""


@pytest.fixture(scope="module")
def page_of_tiny(tmp_path_factory) -> Path:
    """Return the page of the weights that come with the package, on unseen streets, which are rendered if missing."""
    path = tmp_path_factory.mktemp("tiny") / "view.html"
    command = [sys.executable, "src/view.py", "run=tiny", "page=true", f"output={path}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, timeout=3600)
    return path


@pytest.mark.browser
@pytest.mark.skipif("OMNIOCC_SCREENSHOTS" not in os.environ, reason="OMNIOCC_SCREENSHOTS names the images' folder")
def test_images_of_the_documentation(page_of_tiny, open_page):
    folder = ROOT / os.environ["OMNIOCC_SCREENSHOTS"]
    for name, (window, keys, click) in SHOTS.items():
        page = open_page(page_of_tiny, **window)
        for key in keys:
            page.page.keyboard.press(key)
        if click is not None:
            image, across, down = click
            box = page.page.locator("#images .press").nth(image).bounding_box()
            page.page.mouse.click(box["x"] + box["width"] * across, box["y"] + box["height"] * down)
            page.page.wait_for_selector("#readout table")
        page.drawn()
        page.page.wait_for_timeout(500)
        path = folder / f"{name}.jpg"
        page.page.screenshot(path=path, type="jpeg", quality=74)
        assert 10_000 < path.stat().st_size < LARGEST_BYTES
