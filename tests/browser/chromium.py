"""The browser of the tests: how it is found and started, and the time that it takes."""

import shutil

import cv2
import numpy as np

ARGUMENTS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
"""Software WebGL, also as root."""
NAMES = ("chromium", "chromium-browser", "google-chrome")


def find_chromium() -> str | None:
    """Return the path of an installed Chromium; None without one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


def processor_s(session) -> float:
    """Return the processor time of all processes of a browser, s; `session` is one of its DevTools protocol."""
    return sum(process["cpuTime"] for process in session.send("SystemInfo.getProcessInfo")["processInfo"])


def screen(page) -> np.ndarray:
    """Return the pixels (height, width, 3) of the canvas as they are on the screen."""
    page.drawn()
    page.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    data = np.frombuffer(page.page.locator("#canvas").screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def frame_of(page) -> int:
    """Return the number of the frame that a page shows, once it is drawn."""
    page.drawn()
    return page.js("omniocc.state.frame")
