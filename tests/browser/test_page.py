"""The page as people use it: frames, classes, views, rays, keys, colours, small screens; it asks for nothing else."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from chromium import frame_of, processor_s, screen
from made_page import CYLINDER, EVIL, RAYIOU, RUNS, made_frames, made_shown, rig, street

from omniocc.classes import FREE, UNKNOWN, WORLD_CLASSES
from omniocc.draw.bev import ERRORS
from omniocc.extras.viewer.page import write_page

pytestmark = pytest.mark.browser
LOAD_S = 3.0
WORST = list(np.argsort(RAYIOU))


def test_every_view_shows_voxels_and_each_another_image(open_page, made):
    thirds = np.split(screen(open_page(made[1], width=1200))[60:-50, :1164], 3, axis=1)
    assert all(third.std() > 15 for third in thirds)
    means = [third.reshape(-1, 3).mean(0) for third in thirds]
    assert min(np.abs(means[a] - means[b]).max() for a, b in ((0, 1), (0, 2), (1, 2))) > 1


def test_the_page_is_complete_in_itself(open_page, made):
    page = open_page(made[1])
    policy = page.js("document.querySelector('meta[http-equiv]').content")
    assert "default-src 'none'" in policy
    assert not re.search(r"unsafe|https?:|\*", policy)
    blocked = page.js("fetch('https://example.org/').then(() => 'loaded', error => String(error))")
    assert "TypeError" in blocked
    assert all("Content Security Policy" in error for error in page.errors)
    page.errors.clear()  # the two messages of the attempt above


def test_names_with_html_are_inert_text(open_page, made):
    page = open_page(made[2], "#frame=2")
    assert page.js("window.hacked") is None
    assert EVIL in page.page.inner_text("#where")
    assert RUNS[1] in page.page.title()
    assert page.js("document.querySelectorAll('img[src=x], b b, select b').length") == 0
    assert json.loads(page.js("JSON.stringify(omniocc.page.frames.map(frame => frame.scene))"))[2] == EVIL


def test_the_page_needs_less_than_three_seconds(browser, made):
    """All processes of the browser together: a computer that does nothing else needs at most that long."""
    session = browser.new_browser_cdp_session()
    needed_s = []
    for _ in range(2):
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        began_s = processor_s(session)
        page.goto(made[1].as_uri())
        page.evaluate("omniocc.drawn()")
        needed_s.append(processor_s(session) - began_s)
        page.close()
    assert min(needed_s) < LOAD_S


def test_slider_buttons_and_address_choose_the_frame(open_page, made):
    page = open_page(made[1], "#frame=3")
    assert frame_of(page) == 3
    assert "frame 000001" in page.page.inner_text("#where")
    page.page.locator("#frame").fill("5")
    assert frame_of(page) == 5
    page.page.click("#before")
    assert frame_of(page) == 4
    assert page.js("location.hash") == "#frame=4"
    page.page.click("#after")
    page.page.click("#after")
    assert frame_of(page) == 5  # the last one
    page.js("location.hash = '#scene=test-000-oldtown&frame=1'")
    page.until("omniocc.state.frame === 1")
    page.page.click("#bars [data-frame='2']")
    assert frame_of(page) == 2


def test_an_address_of_a_frame_that_is_not_there_says_so(open_page, made):
    page = open_page(made[1], "#scene=test-009&frame=7")
    assert "Frame 7 of test-009 is not in this page" in page.page.inner_text("#hint")
    assert frame_of(page) == 0


def test_another_frame_has_other_voxels_and_images(open_page, made):
    page = open_page(made[1])
    before, first = screen(page), page.js("document.querySelector('#images img').src")
    page.page.keyboard.press("ArrowRight")
    assert frame_of(page) == 1
    assert page.js("document.querySelector('#images img').src") != first
    assert (np.abs(screen(page).astype(int) - before).max(-1) > 30).mean() > 0.02


@pytest.mark.parametrize("width", [400, 1200])
def test_images_alone_go_on_from_frame_to_frame(open_page, tmp_path, width):
    """A log without LiDAR, without a model: no voxels, no truth."""
    frames = [replace(frame, truth={}) for frame in made_frames(())]
    write_page(
        shown := replace(made_shown(()), grids=(CYLINDER,), read=lambda: iter(frames)), shown, tmp_path / "v.html"
    )
    page = open_page(tmp_path / "v.html", width=width)
    first = page.js("document.querySelector('#images img').src")
    page.page.keyboard.press("ArrowRight")
    assert frame_of(page) == 1
    assert page.js("document.querySelector('#images img').src") != first
    assert page.errors == []


def test_only_figures_that_occur_can_be_chosen(open_page, made):
    """Frames have RayIoU and IoU; their mIoU is unknown."""
    page = open_page(made[1])
    figures = "[...document.querySelector('#worst select').options].map(option => option.text)"
    assert page.js(figures) == ["voxel RayIoU", "IoU"]
    page.page.locator("#worst select").first.select_option("IoU")
    assert page.js(figures) == ["voxel RayIoU", "IoU"]


def test_play_goes_on_by_itself_and_stops(open_page, made):
    page = open_page(made[1])
    page.page.select_option("#speed", "10")
    page.page.locator("body").press(" ")
    page.until("omniocc.state.frame >= 2")
    page.page.click("#play")
    stopped = frame_of(page)
    page.page.wait_for_timeout(400)
    assert frame_of(page) == stopped
    assert page.page.inner_text("#play") == "Play"


def test_the_worst_frames_come_first(open_page, made):
    page = open_page(made[1])
    listed = page.page.locator("#worst [data-frame]").evaluate_all("found => found.map(each => +each.dataset.frame)")
    assert listed == WORST[:3]
    found = []
    for _ in range(4):
        page.page.keyboard.press("w")
        found.append(frame_of(page))
    page.page.keyboard.press("Shift+W")
    assert [*found, frame_of(page)] == [*WORST[:4], WORST[2]]
    assert page.page.locator("#bars .low").count() == 3
    table = page.page.inner_text("#figures")
    assert f"{RAYIOU[WORST[2]]:.3f}" in table
    assert f"{np.mean(RAYIOU):.3f}" in table
    assert "mIoU" not in table  # it is nan in every frame


def test_bars_and_counts_are_those_of_the_chosen_run(open_page, made):
    page = open_page(made[2])
    before = page.page.locator("#kinds .chip").all_inner_texts()
    page.page.get_by_label("Run of the bars").select_option(label=RUNS[1])
    page.drawn()
    assert page.page.locator("#kinds .chip").all_inner_texts() != before
    assert f"{RAYIOU[WORST[0]] - 0.1:.3f}" in page.page.inner_text("#worst")
    page.page.get_by_label("Figure of the bars").select_option(label="IoU")
    page.drawn()
    assert "0.500" in page.page.inner_text("#worst")


def test_classes_can_be_hidden_by_click_and_by_key(open_page, made):
    page = open_page(made[1])
    all_of_them = page.js("omniocc.view3d.triangles()")
    page.page.get_by_role("checkbox", name="Building").uncheck()
    page.drawn()
    fewer = page.js("omniocc.view3d.triangles()")
    assert fewer[0] < all_of_them[0]
    page.page.keyboard.press("4")
    page.drawn()
    assert page.js("omniocc.view3d.triangles()") == all_of_them
    page.page.click("#none")
    page.drawn()
    assert page.js("omniocc.view3d.triangles()") == [0, 0, 0]
    page.page.locator("body").press("0")
    page.drawn()
    assert page.js("omniocc.view3d.triangles()") == all_of_them


def test_classes_list_the_iou_and_the_kinds_of_differences(open_page, made):
    page = open_page(made[1])
    truth, predicted = street(CYLINDER, 0), street(CYLINDER, 0, 0.03)
    known = truth != UNKNOWN
    rows = page.page.locator("#classes .row")
    for label in WORLD_CLASSES.occupied:
        both = known & (truth == label) & (predicted == label)
        either = known & ((truth == label) | (predicted == label))
        shown = rows.nth(label - 1).locator(".score").inner_text()
        assert shown == (f"{both.sum() / either.sum():.2f}" if either.any() else "\u2013")
    kinds = page.page.locator("#kinds .chip").all_inner_texts()
    counts = {
        "right": known & (truth == predicted) & (truth > 0),
        "wrong class": known & (truth != predicted) & (truth > 0) & (predicted > 0),
        "missed": known & (truth > 0) & (predicted == FREE),
        "hallucinated": known & (truth == FREE) & (predicted > 0),
    }
    assert [re.sub(r"\s+", " ", text) for text in kinds] == [f"{name} {int(c.sum()):,}" for name, c in counts.items()]
    assert set(counts) < {name for name, _ in ERRORS}


def test_a_click_on_a_pixel_shows_what_its_ray_hits(open_page, made):
    page = open_page(made[1])
    front = page.page.locator("#images .press").nth(1)
    box = front.bounding_box()
    page.page.mouse.click(box["x"] + box["width"] * 0.3, box["y"] + box["height"] * 0.62)
    page.drawn()
    page.page.wait_for_selector("#readout table")
    name, u, v = re.search(r"(\w+), pixel (\d+), (\d+)", page.page.inner_text("#readout")).groups()
    camera = rig().names.index(name)
    pose = rig().ego_from_camera[camera]
    ray, _ = rig().cameras[camera].unproject(torch.tensor([[float(u), float(v)]], dtype=torch.float64))
    for row, labels in enumerate((street(CYLINDER, 0), street(CYLINDER, 0, 0.03))):
        seen = labels.masked_fill(labels == UNKNOWN, FREE)
        entry_m, label = CYLINDER.trace(seen, pose[None, :3, 3], ray @ pose[:3, :3].T, hit="entry")
        cells = page.page.locator("#readout tr").nth(row).locator("td").all_inner_texts()
        assert cells[1] == WORLD_CLASSES.names[int(label)]
        assert float(cells[2].removesuffix(" m")) == pytest.approx(float(entry_m), abs=0.15)  # half a pixel beside
    assert page.js("omniocc.view3d.ray.children.length") == 3  # the ray and two cells
    page.page.keyboard.press("ArrowRight")
    page.drawn()
    assert page.page.locator("#readout table").count() == 1  # the pixel stays chosen
    page.page.keyboard.press("Escape")
    page.drawn()
    assert page.page.locator("#readout table").count() == 0
    assert page.js("omniocc.view3d.ray.children.length") == 0


def test_a_ray_says_where_its_cells_are(open_page, made):
    page = open_page(made[1])
    page.page.locator("#images .press").nth(1).press("Enter")
    page.page.wait_for_selector("#readout .place")
    ray = page.js("omniocc.state.ray")
    origin, direction = (torch.tensor([ray[key]], dtype=torch.float64) for key in ("origin", "direction"))
    labels = street(CYLINDER, 0)
    entry_m, _ = CYLINDER.trace(labels.masked_fill(labels == UNKNOWN, FREE), origin, direction, hit="entry")
    inside = (origin + (entry_m + 1e-6) * direction)[0]
    x, y, z = CYLINDER.centers(torch.float64)[tuple(CYLINDER.index(inside)[0].tolist())].tolist()
    sides = f"{abs(x):.2f} m {'behind' if x < 0 else 'ahead'}, {abs(y):.2f} m {'right' if y < 0 else 'left'}"
    height = f"z {z:.2f} m".replace("-", "\u2212")
    assert page.page.locator("#readout .place").first.inner_text() == f"truth: {sides}, {height}"
    notes = page.page.locator("#readout .note").all_inner_texts()
    assert notes[0] == "The true cell has 255 or more points; 2 LiDAR rays and 1 camera ray pass it."


def test_a_ray_says_why_cells_on_it_are_unknown(open_page, made):
    page = open_page(made[1])
    labels = street(CYLINDER, 0)
    cell = next(centre for centre in CYLINDER.centers(torch.float64)[labels == UNKNOWN] if centre.norm() > 3)
    page.js(f"omniocc.setRay({{ name: 'made', origin: [0, 0, 0], direction: {(cell / cell.norm()).tolist()} }})")
    page.page.wait_for_selector("#readout >> text=No point is in the first of them, and no ray reaches it.")


def test_colours_of_differences_and_ranges_are_explained(open_page, made):
    page = open_page(made[1])
    legends = page.page.locator("#heads .legend")
    assert legends.all_inner_texts() == ["right\nwrong class\nmissed\nhallucinated"]
    swatch, chip = (
        f"getComputedStyle(document.querySelectorAll('{where} .swatch')[2]).backgroundColor"
        for where in ("#heads", "#kinds")
    )
    assert page.js(swatch) == page.js(chip)
    page.page.click("#safe")
    assert page.js(swatch) == page.js(chip)
    page.page.locator("#heads select").nth(2).select_option(label="truth")
    page.drawn()
    assert legends.count() == 0
    ticks = page.page.locator(".scale span")
    assert ticks.all_inner_texts() == ["1 m", "2 m", "4 m", "8 m", "16 m", "32 m", "64 m"]
    assert f"mean of {len(RAYIOU)} frames" in page.page.inner_text("#figures")


def test_pixels_without_a_ray_and_the_panorama(open_page, made):
    page = open_page(made[1])
    box = page.page.locator("#images .press").nth(1).bounding_box()
    page.page.mouse.click(box["x"] + 2, box["y"] + 2)
    page.page.wait_for_selector("#readout .note >> text=The lens does not see there")
    page.page.locator("#panoramas .press").first.scroll_into_view_if_needed()
    box = page.page.locator("#panoramas .press").first.bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.wait_for_selector("#readout >> text=panorama")
    direction = page.js("omniocc.state.ray.direction")
    assert np.allclose(direction, [1, 0, 0], atol=0.06)  # the middle of a panorama looks forward


def test_the_arrow_keys_move_the_pixel_of_a_focused_image(open_page, made):
    page = open_page(made[1])
    front = page.page.locator("#images .press").nth(1)
    front.press("Enter")
    front.press("ArrowRight")
    page.page.wait_for_selector("#readout >> text=pixel 136, 72")
    assert frame_of(page) == 0


def test_a_click_on_voxels_names_the_cell(open_page, made):
    page = open_page(made[1])
    page.js("omniocc.view3d.look('above')")
    page.drawn()
    box = page.page.locator("#canvas").bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 6, box["y"] + box["height"] * 0.4)
    page.page.wait_for_selector("#readout >> text=from the viewpoint")
    assert page.page.locator("#readout tr").nth(0).locator("td").nth(1).inner_text() in WORLD_CLASSES.names


def test_dragging_and_keys_turn_all_views_together(open_page, made):
    page = open_page(made[1])
    eye = page.js("omniocc.view3d.camera.position.toArray()")
    box = page.page.locator("#canvas").bounding_box()
    page.page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.page.mouse.down()
    page.page.mouse.move(box["x"] + 420, box["y"] + 210, steps=4)
    page.page.mouse.up()
    dragged = page.js("omniocc.view3d.camera.position.toArray()")
    assert np.abs(np.subtract(dragged, eye)).max() > 1
    before = screen(page)
    page.page.keyboard.press("Shift+ArrowLeft")
    page.page.keyboard.press("+")
    changed = (np.abs(screen(page).astype(int) - before).max(-1) > 12)[60:-60]
    assert all(third.mean() > 0.05 for third in np.array_split(changed, 3, axis=1))
    page.page.keyboard.press("b")
    assert np.allclose(page.js("omniocc.view3d.camera.position.toArray()"), eye, atol=1e-6)


def test_views_show_what_is_chosen_for_them(open_page, made):
    page = open_page(made[2])
    titles = page.page.locator("#heads select").nth(0).locator("option").all_inner_texts()
    predictions = [title for run in RUNS[:2] for title in (run, f"differences, {run}")]
    assert titles == ["truth, cylinder", "truth, cuboid", *predictions]
    triangles = page.js("omniocc.view3d.triangles()")
    page.page.locator("#heads select").nth(1).select_option(label=titles[-1])
    page.drawn()
    assert page.js("omniocc.state.views[1]") == "differences-1"
    assert page.js("omniocc.view3d.triangles()")[1] != triangles[1]


def test_scenes_without_a_model_have_one_view_and_no_figures(open_page, made):
    page = open_page(made[0])
    assert page.js("omniocc.state.views") == ["truth-0"]
    assert page.page.locator("#worst button").count() == 0
    assert not page.page.is_visible("#figures")
    assert not page.page.is_visible("#kinds")
    assert page.page.locator("#classes .score").first.inner_text().endswith("%")


def test_predictions_without_truth_and_images_are_shown(open_page, tmp_path):
    shown = made_shown(RUNS[:1])
    bare = {"truth": {}, "images": (), "rig": None, "range_m": None}
    frames = [
        replace(frame, **bare, predictions={RUNS[0]: replace(frame.predictions[RUNS[0]], range_m=None, figures={})})
        for frame in made_frames(RUNS[:1])
    ]
    write_page(shown, frames, tmp_path / "view.html")
    page = open_page(tmp_path / "view.html")
    assert page.js("omniocc.state.views") == ["run-0"]
    assert page.js("omniocc.view3d.triangles()")[0] > 100
    hidden = ("#cameras", "#figures", "#kinds", "#bars", "#worst button")
    assert [each for each in hidden if page.page.is_visible(each)] == []
    assert page.page.locator("#classes .score").first.inner_text().endswith("%")
