"""What the page draws and traces is what omniocc computes: surfaces, first hits, directions of pixels, silhouettes."""

import base64

import cv2
import numpy as np
import pytest
import torch
from made_page import CUBOID, CYLINDER, rig, street

from omniocc.classes import FREE, UNKNOWN
from omniocc.extras.viewer.page.pack import Packed
from omniocc.geometry import Cuboid, Cylinder, Grid
from rayiou.surface import extract_surface

pytestmark = pytest.mark.browser
HOLLOW = Cylinder((7, 9, 5), (1.5, 12.0), (-2.0, 2.0))
GRIDS = {"cylinder": CYLINDER, "cuboid": CUBOID, "hollow": HOLLOW, "slab": Cuboid((5, 3, 2), (-4, 6), (-3, 2), (-1, 1))}
LOAD = """async ([facts, labels]) => {
  const { Grid } = await import("omniocc/grid.js");
  window.volume = { grid: new Grid(facts), labels: Uint8Array.from(labels) };
}"""


@pytest.fixture(scope="module")
def shared(browser, made):
    """Return a page whose modules are called; it shows two runs."""
    page = browser.new_page(viewport={"width": 900, "height": 500})
    page.goto(made[2].as_uri())
    yield page
    page.close()


def facts_of(grid: Grid) -> dict:
    """Return a grid as the page gets it."""
    packed = Packed.__new__(Packed)
    packed.facts, packed._grids = {"grids": []}, {}
    packed._grid(grid)
    return packed.facts["grids"][0]


def scattered(grid: Grid, fraction: float) -> torch.Tensor:
    """Return a street with further cells of random classes and unknown ones."""
    random = np.random.default_rng(5)
    labels = street(grid, 1)
    changed = torch.from_numpy(random.random(grid.shape) < fraction)
    labels[changed] = torch.from_numpy(random.choice([0, 2, 4, 9, 255], int(changed.sum())).astype(np.uint8))
    return labels


def single_faces(rows: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Return axis, side, cell and label of every cell's face that merged faces cover."""
    found = []
    for axis, side, layer, i0, i1, j0, j1, label in rows:
        for i in range(i0, i1):
            for j in range(j0, j1):
                index = [0, 0, 0]
                index[axis], index[(axis + 1) % 3], index[(axis + 2) % 3] = layer, i, j
                found.append((axis, side, np.ravel_multi_index(index, shape), label))
    return np.array(sorted(found))


@pytest.mark.parametrize("name", GRIDS)
def test_merged_faces_cover_each_face_of_the_surface_once(name, shared):
    grid = GRIDS[name]
    labels = scattered(grid, 0.05)
    shared.evaluate(LOAD, [facts_of(grid), labels.flatten().tolist()])
    rows = shared.evaluate(
        """() => { const visible = new Uint8Array(256).fill(1); visible[0] = visible[255] = 0;
           return Array.from(omniocc.faces(volume.grid, volume.labels, visible)); }"""
    )
    rows = np.array(rows).reshape(-1, 8)
    expected = extract_surface((labels != FREE) & (labels != UNKNOWN), grid)
    area = np.linalg.norm(np.cross(*np.moveaxis(expected.corners_m[:, 2:] - expected.corners_m[:, :2], 1, 0)), axis=1)
    found = single_faces(rows, grid.shape)
    cells = expected.cells[area > 1e-12]  # at a cylinder's axis faces have no area
    assert np.array_equal(np.sort(found[:, 2]), np.sort(cells))
    assert len(np.unique(found, axis=0)) == len(found)
    assert np.array_equal(found[:, 3], labels.flatten().numpy()[found[:, 2]])
    if name in ("cylinder", "cuboid"):
        assert len(rows) < 0.7 * len(found)
    if isinstance(grid, Cylinder):
        along_theta = np.where(
            rows[:, 0] == 0, rows[:, 4] - rows[:, 3], np.where(rows[:, 0] == 2, rows[:, 6] - rows[:, 5], 1)
        )
        assert along_theta.max() == 1  # no face bends


@pytest.mark.parametrize("name", GRIDS)
def test_corners_of_faces_are_those_of_the_surface(name, shared):
    grid = GRIDS[name]
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[tuple(size // 2 for size in grid.shape)] = 4
    shared.evaluate(LOAD, [facts_of(grid), labels.flatten().tolist()])
    found = shared.evaluate(
        """async () => { const { vertices } = await import("omniocc/mesh.js");
           const rows = omniocc.faces(volume.grid, volume.labels, omniocc.stopping(false));
           const mesh = vertices(volume.grid, rows, 0);
           return [Array.from(mesh.position), Array.from(mesh.normal)]; }"""
    )
    corners, normals = (np.array(part).reshape(6, 4, 3) for part in found)
    expected = extract_surface(labels == 4, grid).corners_m
    outward = np.cross(expected[:, 2] - expected[:, 0], expected[:, 3] - expected[:, 1])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    for ours, ours_normal, theirs, theirs_normal in zip(corners, normals, expected, outward, strict=True):
        turns = [np.roll(theirs, turn, 0) for turn in range(4)]
        assert min(np.abs(ours - turn).max() for turn in turns) < 1e-5
        assert np.abs(ours_normal - theirs_normal).max() < 1e-5


def rays(grid: Grid, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and directions: any, from the origin, along axes and faces, from outside, and that miss."""
    random = np.random.default_rng(2)
    origins = random.uniform(-20, 20, (count, 3)) * [1, 1, 0.1]
    directions = random.normal(size=(count, 3)) * [1, 1, 0.3]
    origins[: count // 3] = 0
    turns = np.arange(24) * (2 * np.pi / 24)
    level = np.stack([np.cos(turns), np.sin(turns), np.zeros(24)], 1)
    special = [level, np.round(level), [[0.0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0]]]
    directions = np.concatenate([directions, *special])
    origins = np.concatenate([origins, np.zeros((len(directions) - count, 3))])
    outside = np.array([[40.0, 3, 1], [-50, -50, 9], [0, 0, 30], [60, 0, 0]])
    inward = -outside + [[0, 0, 0], [1, 2, 0], [0.3, 0.2, 0], [0, 90, 0]]
    keep = np.linalg.norm(directions, axis=1) > 0
    return np.concatenate([origins[keep], outside]), np.concatenate([directions[keep], inward])


@pytest.mark.parametrize("unknown", [False, True])
@pytest.mark.parametrize("name", GRIDS)
def test_rays_hit_the_cells_that_omniocc_finds(name, unknown, shared):
    grid = GRIDS[name]
    labels = scattered(grid, 0.01 if grid.num_cells > 1000 else 0.5)
    if grid.num_cells > 1000:
        labels[grid.distances_m() < 2.5] = FREE  # rays from the origin get away
    origins, directions = rays(grid, 400)
    shared.evaluate(LOAD, [facts_of(grid), labels.flatten().tolist()])
    found = shared.evaluate(
        """([origins, directions, unknown]) => origins.map((origin, k) => {
           const hit = omniocc.trace(volume.grid, volume.labels, origin, directions[k], omniocc.stopping(unknown));
           return [hit.cell, hit.label, ...[hit.entry, hit.exit].map(at => Number.isFinite(at) ? at : -1)]; })""",
        [origins.tolist(), directions.tolist(), unknown],
    )
    seen = labels if unknown else labels.masked_fill(labels == UNKNOWN, FREE)
    hits = grid.cast(seen, torch.from_numpy(origins), torch.from_numpy(directions))
    cells, classes, entry_m, exit_m = np.array(found).T
    assert np.array_equal(cells, hits.cells.numpy())
    assert np.array_equal(classes, hits.labels.numpy())
    for ours, theirs in ((entry_m, hits.entry_m), (exit_m, hits.exit_m)):
        expected = theirs.double().nan_to_num(posinf=-1.0).numpy()
        assert np.abs(ours - expected).max() < 1e-4
    traced_m, traced = grid.trace(seen, torch.from_numpy(origins), torch.from_numpy(directions))
    assert np.array_equal(classes, traced.numpy())
    assert np.abs(exit_m - traced_m.double().nan_to_num(posinf=-1.0).numpy()).max() < 1e-4
    assert 20 < (classes > 0).sum() < len(classes)


def test_pixels_have_the_rays_of_the_rig_and_none_outside_of_the_lens(shared):
    random = np.random.default_rng(3)
    for number, camera in enumerate(rig().cameras):
        u = random.integers(0, camera.width, 150)
        v = random.integers(0, camera.height, 150)
        exact, valid = (part.numpy()[v, u] for part in rig().rays(number))
        found = shared.evaluate(
            """async ([number, pixels]) => { const { rayOf } = await import("omniocc/lens.js");
               return Promise.all(pixels.map(([u, v]) => rayOf(omniocc.page.rigs[0].cameras[number], u, v))); }""",
            [number, np.stack([u, v], 1).tolist()],
        )
        assert np.array_equal([ray is not None for ray in found], valid)
        assert 0 < valid.mean() < 1
        directions = np.array([ray["direction"] for ray in found if ray])
        angle = np.degrees(2 * np.arcsin(np.linalg.norm(directions - exact[valid], axis=1) / 2))
        assert angle.max() < 0.1
        assert np.allclose([ray["origin"] for ray in found if ray], rig().ego_from_camera[number, :3, 3])


def snapshot(page, view: int, width: int = 320, height: int = 240) -> tuple[np.ndarray, dict]:
    """Return RGBA (height, width, 4), first row at the top, and the camera of one view."""
    found = page.evaluate(
        """([view, width, height]) => { const shot = omniocc.view3d.snapshot(view, width, height);
           let text = ""; for (const value of shot.rgba) text += String.fromCharCode(value);
           return { ...shot, rgba: btoa(text) }; }""",
        [view, width, height],
    )
    rgba = np.frombuffer(base64.b64decode(found["rgba"]), np.uint8).reshape(height, width, 4)
    return rgba[::-1], found


def view_rays(camera: dict, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the eye and the directions (height, width, 3) of a view's pixels."""
    eye, target = np.array(camera["eye"]), np.array(camera["target"])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(camera["fov_deg"]) / 2)
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * half * width / height
    above = (1 - (np.arange(height) + 0.5) / height * 2) * half
    directions = forward + across[None, :, None] * right + above[:, None, None] * up
    return eye, directions


def cast(grid: Grid, labels: torch.Tensor, camera: dict, width: int = 320, height: int = 240) -> np.ndarray:
    """Return the class (height, width) that our own ray caster sees in every pixel of a view; 0 for none."""
    eye, directions = view_rays(camera, width, height)
    flat = torch.from_numpy(directions.reshape(-1, 3))
    seen = labels.masked_fill(labels == UNKNOWN, FREE)
    return grid.trace(seen, torch.from_numpy(eye).expand_as(flat), flat)[1].numpy().reshape(height, width)


def iou(first: np.ndarray, second: np.ndarray) -> float:
    return (first & second).sum() / (first | second).sum()


VIEWS = {
    "behind": "omniocc.view3d.look('behind')",
    "low": "omniocc.view3d.look({eye: [-9, 14, 3], target: [2, -1, 0]})",
    "inside": "omniocc.view3d.look({eye: [0, 0, 0.5], target: [3, 4, 0]})",
}


@pytest.mark.parametrize("look", VIEWS)
def test_silhouettes_are_those_of_our_own_ray_caster(look, shared):
    shared.evaluate("omniocc.show(1)")
    shared.evaluate(VIEWS[look])
    shown = ((CYLINDER, street(CYLINDER, 1)), (CYLINDER, street(CYLINDER, 1, 0.03)), (CUBOID, street(CUBOID, 1, 0.03)))
    for view, (grid, labels) in enumerate(shown):
        rgba, camera = snapshot(shared, view)
        seen = cast(grid, labels, camera)
        assert (seen > 0).mean() > 0.2
        assert iou(rgba[..., 3] > 0, seen > 0) >= 0.98
        inside = cv2.erode((seen > 0).astype(np.uint8), np.ones((5, 5))) > 0
        assert rgba[..., 3][inside].all()  # no gaps between faces


@pytest.mark.parametrize("label", [1, 4, 9])
def test_a_class_alone_has_the_silhouette_of_its_cells(label, open_page, made):
    page = open_page(made[1])
    page.page.click("#none")
    page.page.keyboard.press(str(label))
    page.drawn()
    rgba, camera = snapshot(page.page, 0)
    labels = street(CYLINDER, 0)
    seen = cast(CYLINDER, torch.where(labels == label, labels, 0), camera) > 0
    assert seen.sum() > 50
    assert iou(rgba[..., 3] > 0, seen) >= (
        0.98 if seen.sum() > 2000 else 0.9
    )  # a thin pole is little more than its border


def test_differences_have_the_colours_of_their_kinds(open_page, made):
    page = open_page(made[1])
    truth, predicted = street(CYLINDER, 0), street(CYLINDER, 0, 0.03)
    known = truth != UNKNOWN
    kinds = torch.zeros_like(truth)
    kinds[known & (truth == predicted) & (truth > 0)] = 1
    kinds[known & (truth != predicted) & (truth > 0) & (predicted > 0)] = 2
    kinds[known & (truth > 0) & (predicted == 0)] = 3
    kinds[known & (truth == 0) & (predicted > 0)] = 4
    assert all((kinds == kind).sum() > 5 for kind in range(1, 5))
    rgba, camera = snapshot(page.page, 2, 640, 480)
    seen = cast(CYLINDER, kinds, camera, 640, 480)
    assert iou(rgba[..., 3] > 0, seen > 0) >= 0.98
    palette = np.array([kind["rgb"] for kind in page.js("omniocc.page.kinds")], float)
    colors = rgba[..., :3].astype(float)
    nearest = np.stack([_angle(colors, color) for color in palette[1:]]).argmin(0) + 1
    both = (rgba[..., 3] > 0) & (seen > 0)
    assert (nearest == seen)[both].mean() > 0.95
    page.page.locator("#kinds input").nth(0).click()  # without those that are right
    page.drawn()
    rgba, camera = snapshot(page.page, 2, 640, 480)
    assert iou(rgba[..., 3] > 0, cast(CYLINDER, torch.where(kinds > 1, kinds, 0), camera, 640, 480) > 0) >= 0.97


def _angle(colors: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Return how far colours differ in hue: 1 minus the cosine of the angle between them."""
    return 1 - (colors @ color) / np.maximum(np.linalg.norm(colors, axis=-1) * np.linalg.norm(color), 1e-9)
