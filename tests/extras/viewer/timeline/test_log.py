"""Frames as files of the Rerun viewer, read back and compared with what they were made of."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_scenes import FRAMES, RIG, SCENES
from recordings import below, read

from omniocc.classes import WORLD_CLASSES
from omniocc.extras.viewer.collect import open_shown
from omniocc.extras.viewer.frames import Shown
from omniocc.extras.viewer.options import ViewOptions
from omniocc.extras.viewer.timeline.log import grid_name, show
from rayiou.surface import drop_flat_faces, extract_surface

pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")
EVIL = 'a/b <script>alert(1)</script> \\ ünï: "x" ../../{c}\n[d]$origin/**'


@pytest.fixture(scope="module")
def frames(cylinder_run, cuboid_run):
    shown = open_shown(ViewOptions(run=[str(cylinder_run), str(cuboid_run)]))
    return shown, list(shown)


def again(shown: Shown, frames, **changes) -> Shown:
    """Return frames that are computed already."""
    names = tuple((frame.scene, frame.frame) for frame in frames)
    return replace(shown, frames=names, read=lambda: iter(frames), **changes)


@pytest.fixture(scope="module")
def recorded(frames, tmp_path_factory):
    path = tmp_path_factory.mktemp("timeline") / "view.rrd"
    show(again(*frames), path, None)
    assert [file.name for file in path.parent.iterdir()] == ["view.rrd"]
    return read(path)


def triangles_of(logged):
    """Return the corners of all triangles as a sorted list of nine numbers each."""
    corners = [row.array("Mesh3D:vertex_positions")[row.array("Mesh3D:triangle_indices")] for row in logged.values()]
    flat = np.concatenate(corners).astype(np.float32).reshape(-1, 9)
    return flat[np.lexsort(flat.T)]


def test_voxels_are_the_exact_surface_of_the_labels(frames, recorded):
    _, given = frames
    for k, frame in enumerate(given):
        known = {
            f"truth\\,\\ {grid_name(grid).replace(' ', chr(92) + ' ')}": (grid, labels)
            for grid, labels in frame.truth.items()
        }
        known |= {name: (one.grid, one.labels) for name, one in frame.predictions.items()}
        assert len(known) == 4
        for name, (grid, labels) in known.items():
            logged = below(recorded, f"/world/ego/voxels/{name}", k)
            present = {row.name for row in WORLD_CLASSES.rows if (labels == row.id).any() and row.id}
            assert set(logged) <= present
            quads = drop_flat_faces(extract_surface((labels != 0) & (labels != 255), grid)).corners_m.astype(np.float32)
            expected = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 9) + np.float32(0)
            found = triangles_of(logged)
            assert len(found) == len(expected) > 100
            assert np.array_equal(found, expected[np.lexsort(expected.T)])


def test_faces_have_the_colour_of_their_class_darker_in_the_shade(frames, recorded):
    _, given = frames
    name = next(iter(given[0].predictions))
    for kind, row in below(recorded, f"/world/ego/voxels/{name}", 0).items():
        rgb = np.array(next(entry.rgb for entry in WORLD_CLASSES.rows if entry.name == kind))
        packed = row.array("Mesh3D:vertex_colors")
        colors = np.stack([packed >> shift & 255 for shift in (24, 16, 8)], -1)
        brightness = colors.max(-1) / rgb.max()
        assert brightness.min() == pytest.approx(0.62, abs=0.02)
        assert brightness.max() <= 1.05
        assert np.abs(colors - brightness[:, None] * rgb).max() < 2


def test_each_frame_has_its_place_in_time_and_its_figures(frames, recorded):
    shown, given = frames
    for name in shown.models:
        curve = recorded[f"/figures/rayiou/{name}"]
        assert [row.frame for row in curve] == list(range(FRAMES))
        values = [float(row.array("Scalars:scalars")[0]) for row in curve]
        assert values == [frame.predictions[name].figures["rayiou"] for frame in given]
    texts = recorded["/frame"]
    assert SCENES[1] in texts[1].columns["TextDocument:text"][0]
    times_s = [row.columns["time"].total_seconds() for row in texts]
    assert np.allclose(times_s, [0.0, 0.5, 1.0])
    columns = "rerun.controls.RowId frame time Transform3D:mat3x3 Transform3D:translation"
    assert set(recorded["/world/ego"][0].columns) == set(columns.split())


def test_poses_begin_near_the_origin(frames, recorded):
    _, given = frames
    places = [row.array("Transform3D:translation")[0] for row in recorded["/world/ego"]]
    expected = [frame.world_from_ego[:3, 3] - given[0].world_from_ego[:3, 3] for frame in given]
    assert np.allclose(places, expected, atol=1e-6)
    (strip,) = recorded["/world/trajectory"][2].columns["LineStrips3D:strips"]
    assert np.allclose(strip, expected, atol=1e-6)


def test_images_ranges_points_and_cameras(frames, recorded):
    _, given = frames
    for name in RIG.names:
        assert recorded[f"/images/{name}"][0].columns["EncodedImage:media_type"] == ["image/jpeg"]
        for model in given[0].predictions:
            (row, *_) = recorded[f"/images/{name}/{model}"]
            (form,) = row.columns["SegmentationImage:format"]
            assert (form["width"], form["height"]) == (64, 36)
    assert [row.frame for row in recorded["/world/ego/cameras/front"]] == [0]  # as it does not move
    model, one = next(iter(given[1].predictions.items()))
    row = recorded[f"/ranges/{model}"][1]
    codes = np.frombuffer(bytes(row.columns["DepthImage:buffer"][0]), np.uint16).reshape(one.range_m.shape)
    known = one.range_m.isfinite().numpy()
    assert known.any()
    assert np.allclose(codes[known] / 256, one.range_m.numpy()[known], atol=1 / 256)
    assert (codes[~known] == 0).all()
    points = recorded[f"/world/ego/points/{model}"][1].array("Points3D:positions")
    assert len(points) == known.sum()
    assert np.allclose(np.linalg.norm(points, axis=1), one.range_m.numpy()[known], rtol=1e-5)
    hits = np.isfinite(given[0].lidar.range_m).sum()
    assert len(recorded["/world/ego/lidar"][0].columns["Points3D:positions"]) == hits


def test_what_a_frame_lacks_is_cleared(frames, tmp_path):
    shown, given = frames
    grid = shown.grids[0]
    empty = torch.zeros(grid.shape, dtype=torch.uint8)
    without = replace(given[1], truth={grid: empty}, lidar=None, predictions={})
    show(again(shown, [given[0], without, given[2]]), tmp_path / "v.rrd", None)
    found = read(tmp_path / "v.rrd")
    name = shown.models[0]
    kinds = [path for path in found if path.startswith(f"/world/ego/voxels/{name}/")]
    assert kinds
    for path in [*kinds, "/world/ego/lidar", f"/images/front/{name}"]:
        rows = {row.frame: row.columns for row in found[path]}
        assert "Clear:is_recursive" in rows[1] or 0 not in rows
    assert "Clear:is_recursive" not in {row.frame: row.columns for row in found["/images/front"]}[1]


def test_odd_names_do_no_harm(frames, tmp_path):
    shown, given = frames
    odd = []
    for frame in given[:2]:
        (first, *_) = frame.predictions.values()
        odd.append(replace(frame, scene=EVIL, predictions={EVIL: first, "truth": first}))
    path = tmp_path / "<b>x & y.rrd"
    show(again(shown, odd, models=(EVIL, "truth"), source=EVIL), path, None)
    found = read(path)
    texts = [row.columns for row in found["/frame"]]
    assert texts[0]["TextDocument:media_type"] == ["text/plain"]
    assert texts[0]["TextDocument:text"][0].startswith(EVIL)
    paths = [name for name in found if name.startswith("/figures/rayiou/")]
    assert len(paths) == 2  # neither is split into parts, and none is taken for the truth
    assert "/figures/rayiou/model\\ truth" in paths
    cameras = [name for name in found if name.startswith("/world/ego/cameras/")]
    assert len(cameras) == len(RIG.names)


def test_several_scenes_follow_one_another_on_the_time_line(dataset, tmp_path):
    shown = open_shown(ViewOptions(recorded=str(dataset), limit=4))
    show(shown, tmp_path / "v.rrd", None)
    found = read(tmp_path / "v.rrd")
    times_s = [row.columns["time"].total_seconds() for row in found["/frame"]]
    assert np.allclose(times_s, [0.0, 0.5, 1.0, 1.5])
    lengths = [len(row.columns["LineStrips3D:strips"][0]) for row in found["/world/trajectory"]]
    assert lengths == [1, 2, 3, 1]
    assert not any(path.startswith("/figures") for path in found)
