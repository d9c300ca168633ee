"""The page's colours, contrast, small screens, keys and names of controls."""

import numpy as np
import pytest
from chromium import frame_of, screen
from made_page import SCENES

pytestmark = pytest.mark.browser


def test_colours_follow_the_scheme_and_the_switch(open_page, made):
    page = open_page(made[1], color_scheme="dark")
    assert page.js("document.documentElement.dataset.theme") == "dark"
    background = "getComputedStyle(document.body).backgroundColor"
    dark = page.js(background)
    page.page.keyboard.press("d")
    assert page.js("document.documentElement.dataset.theme") == "light"
    assert page.js(background) != dark
    swatch = "document.querySelector('#classes .swatch').style.background"
    before, shot = page.js(swatch), screen(page)
    page.page.click("#safe")
    assert page.js(swatch) != before
    assert page.page.get_attribute("#safe", "aria-pressed") == "true"
    assert (np.abs(screen(page).astype(int) - shot).max(-1) > 12).mean() > 0.1


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_has_contrast(theme, open_page, made):
    page = open_page(made[1], color_scheme=theme)
    names = ["ink", "soft", "card", "paper", "accent", "on"]
    colors = page.js(
        """names => names.map(name => { const probe = document.createElement("i"); document.body.append(probe);
           probe.style.color = `var(--${name})`; const found = getComputedStyle(probe).color; probe.remove();
           return found.match(/[\\d.]+/g).slice(0, 3).map(Number); })""",
        names,
    )
    light = dict(zip(names, map(luminance, colors), strict=True))
    for text, below in (("ink", "card"), ("ink", "paper"), ("soft", "card"), ("soft", "paper"), ("on", "accent")):
        low, high = sorted([light[text], light[below]])
        assert (high + 0.05) / (low + 0.05) >= 4.5, (text, below)


def luminance(rgb: list[float]) -> float:
    """Return the relative luminance of WCAG 2."""
    parts = [part / 255 for part in rgb]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def test_a_phone_shows_one_view_at_a_time_without_scrolling_sideways(open_page, made):
    page = open_page(made[1], width=390, height=844, has_touch=True, device_scale_factor=2)
    assert page.js("document.documentElement.scrollWidth") <= 390
    assert len(page.js("omniocc.view3d.triangles()")) == 1
    truth = page.js("omniocc.view3d.triangles()")
    tabs = page.page.locator("#tabs [role=tab]")
    assert tabs.all_inner_texts() == ["truth", "prediction", "differences"]
    tabs.nth(1).tap()
    page.drawn()
    assert page.js("omniocc.view3d.triangles()") != truth
    assert tabs.nth(1).get_attribute("aria-selected") == "true"
    assert screen(page).std() > 15
    worst = page.page.locator("#worst button").evaluate_all(
        "all => all.map(each => each.getBoundingClientRect().right)"
    )
    assert max(worst) <= 382  # no frame is cut off
    box = page.page.locator("#canvas").bounding_box()
    page.page.touchscreen.tap(box["x"] + 120, box["y"] + 180)
    page.page.wait_for_selector("#readout table")
    read = page.page.locator("#readout table").bounding_box()
    assert read["y"] + read["height"] <= 844  # what the ray hits is seen without scrolling


def test_controls_have_names_and_the_keyboard_reaches_them(open_page, made):
    page = open_page(made[1])
    nameless = page.js(
        """[...document.querySelectorAll("button, input, select, [role=application], canvas")].filter(each =>
           !(each.getAttribute("aria-label") || each.textContent.trim() || each.closest("label")?.textContent.trim()))
           .map(each => each.outerHTML)"""
    )
    assert nameless == []
    reached = set()
    for _ in range(50):
        page.page.keyboard.press("Tab")
        reached.add(
            page.js("document.activeElement.id || document.activeElement.className || document.activeElement.tagName")
        )
    assert {"safe", "theme", "help", "canvas", "before", "play", "after", "frame", "press"} <= reached
    outline = page.js(
        "document.getElementById('play').focus(), getComputedStyle(document.getElementById('play')).outlineStyle"
    )
    assert outline != "none"


def test_the_list_of_keys_opens_and_closes(open_page, made):
    page = open_page(made[1])
    page.page.keyboard.press("?")
    assert page.page.is_visible("#keylist >> text=worst frame first")
    listed = page.page.locator("#keylist dt").all_inner_texts()
    assert listed[:2] == ["arrow left, right", "space"]
    assert listed.index("0") == listed.index("1 \u2026 9") + 1
    page.page.keyboard.press("ArrowRight")
    assert frame_of(page) == 0
    page.page.keyboard.press("Escape")
    assert not page.page.is_visible("#keylist")
    assert len(SCENES) == 3
