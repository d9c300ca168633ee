"""What `src/check.py` finds in the scenes of any source: wrong classes, points, grids, lenses and motion."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from fake_scene import FakeWorld
from fake_source import CLASSES, FRAMES, GRID, FakeFrames, FakeLabels, FakeSource

from omniocc.data.check_source import Expected, check_frame, check_scene, check_source, start_of_rays
from omniocc.data.source import Points, SourceSpec
from omniocc.errors import DataError
from omniocc.geometry import Cuboid, Cylinder

SPEC = SourceSpec(CLASSES, (0.0, 20.0, 40.0), 0.1, 0.0, None, None)


class Labels(FakeLabels):
    """The same voxels in every frame, or those of the scene."""

    def __init__(self, voxels=None):
        self.voxels = voxels

    def read(self, scene, frame):
        return super().read(scene, frame) if self.voxels is None else self.voxels


def expected(voxels=None, spec=SPEC, grid=GRID) -> Expected:
    return Expected(spec, Labels(voxels), grid)


def scene(**parts) -> FakeFrames:
    """Return a scene of which some parts are replaced: each is what its method returns."""
    found = FakeFrames("town", 0)
    for name, value in parts.items():
        setattr(found, name, lambda frame, value=value: value)
    return found


def voxels(number: int, *cells: tuple[int, int, int]) -> torch.Tensor:
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    for cell in cells:
        labels[cell] = number
    return labels


def points(*positions_m: tuple[float, float, float], labels: int = 1) -> Points:
    return Points(np.array(positions_m, np.float32).reshape(-1, 3), np.full(len(positions_m), labels, np.uint8))


def test_a_sound_source_has_no_problems(tmp_path):
    assert list(check_source(FakeSource(str(tmp_path), with_lidar=True), GRID, frames=0, workers=0)) == []


@pytest.mark.parametrize(
    ("found", "truth", "words"),
    [
        ({}, voxels(19, (0, 0, 0)), "voxels: classes [19] do not exist; the source has 0 to 18, and 255 for unknown"),
        ({}, voxels(1, (0, 0, 0)).float(), "voxels: classes are float32 instead of uint8"),
        (
            {"pixel_labels": [np.array([[3, 255]], np.uint8), np.array([[40, 77]], np.uint8)]},
            None,
            "pixels: classes [40, 77] do not exist",
        ),
        ({"points": points((1, 0, 0), labels=90)}, None, "points: classes [90] do not exist"),
        ({"points": points()}, None, "none of its 0 points lies within 40 m"),
        ({"points": points((4000.0, 100.0, 0.0), (0.0, -41.0, 2.0))}, None, "none of its 2 points lies within 40 m"),
    ],
)
def test_what_is_wrong_in_a_frame_is_named(found, truth, words):
    problems, read = check_frame(scene(**found), expected(truth), 1)
    assert [problem for problem in problems if f"scene 'town', frame 1: {words}" in problem], problems
    assert read is not None


def test_a_point_near_the_car_is_enough():
    problems, _ = check_frame(scene(points=points((4000.0, 100.0, 0.0), (0.0, -39.0, 2.0))), expected(), 1)
    assert problems == []


@pytest.mark.parametrize("grid", [Cuboid((4, 4, 2), (-4, 4), (-4, 4), (-1, 1)), Cylinder((4, 6, 2), (0, 4), (-1, 1))])
def test_rays_begin_in_the_cells_around_the_origin(grid):
    """Of both layers rays in the plane z = 0 begin in the upper one: each cell has its lower end."""
    nothing = torch.zeros(grid.shape, dtype=torch.uint8)
    assert start_of_rays(nothing, grid) is None
    assert start_of_rays(torch.full_like(nothing, 255), grid) is None
    below, above, far = (nothing.clone() for _ in range(3))
    below[..., 0], above[..., 1], far[3, 3, 0] = 5, 7, 9
    assert [start_of_rays(labels, grid) for labels in (below, above, far)] == [0, 7, 0]
    above[..., 1] = 255
    above[3, 3, 0] = 5
    assert start_of_rays(above, grid) == 0


def test_an_origin_in_an_occupied_cell_is_told_unless_the_dataset_has_rays_of_its_own():
    around = [(x, y, 0) for x in (9, 10) for y in (7, 8)]
    inside = voxels(4, *around)
    (problem,), _ = check_scene(scene(), expected(inside), frames=0)
    assert problem.startswith(f"scene 'town': the ego origin lies in an occupied cell (kind4) in {FRAMES} of {FRAMES}")
    own = FakeSource("").spec
    assert own.benchmark is not None
    assert check_scene(scene(), expected(inside, own), frames=0)[0] == []


def test_a_grid_without_occupied_cells_is_told():
    (problem,), read = check_scene(scene(), expected(voxels(0)), frames=0)
    assert "no cell of the model's grid is occupied in 3 frames" in problem
    assert read == FRAMES


def test_a_lens_that_ends_near_its_axis_is_told():
    found = scene()
    lens = found.rigs[0].cameras[0]
    narrow = replace(found.rigs[0], cameras=(_fisheye(lens.width, lens.height, -0.9), *found.rigs[0].cameras[1:]))
    found.rigs = (narrow,) * FRAMES
    problems, _ = check_scene(found, expected(), frames=1)
    assert len(problems) == 1
    assert problems[0].startswith("scene 'town', camera 'camera0': only ")
    assert "KannalaBrandt coefficients" in problems[0]
    found.rigs = (replace(narrow, cameras=(_fisheye(lens.width, lens.height, 0.0), *narrow.cameras[1:])),) * FRAMES
    assert check_scene(found, expected(), frames=1)[0] == []


def _fisheye(width, height, k1):
    from omniocc.camera import KannalaBrandt

    focal = width / 2 / np.radians(90)
    return KannalaBrandt(width, height, (focal, focal), ((width - 1) / 2, (height - 1) / 2), (k1, 0.1, 0, 0), 100.0)


def test_a_scene_that_cannot_tell_its_length_is_a_problem_among_others(tmp_path):
    class Broken(FakeFrames):
        def __len__(self):
            raise DataError("poses.txt: a value of the pose is not finite")

    source = FakeSource(str(tmp_path))
    source.scenes = lambda split: [Broken(split, 0), FakeFrames(f"{split}1", 1)]
    problems = list(check_source(source, GRID, frames=0, workers=0))
    assert problems == ["poses.txt: a value of the pose is not finite"] * 3


def test_a_scene_without_frames_has_no_problem():
    class Empty(FakeFrames):
        rigs = ()
        world_from_ego = np.zeros((0, 4, 4))

        def __len__(self):
            return 0

    assert check_scene(Empty("town", 0), expected(), frames=0) == ([], 0)


def test_classes_of_another_type_around_the_origin_are_only_told():
    around = [(x, y, 0) for x in (9, 10) for y in (7, 8)]
    problems, _ = check_scene(scene(), expected(voxels(4, *around).float()), frames=1)
    assert "voxels: classes are float32 instead of uint8" in problems[0]
    assert "occupied cell (kind4)" in problems[-1]


def test_recorded_poses_that_no_car_has_driven_are_named(tmp_path):
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    (recorded,) = world.scenes("train")
    grid = Cylinder((8, 10, 4), (0.0, 25.6), (-2.8, 3.6))
    spec = replace(world.spec, lidar_directions=None)

    def problems():
        return check_scene(recorded, Expected(spec, world.labels(grid, "none"), grid), frames=1)[0]

    assert not any("jumps" in line for line in problems())
    recorded.world_from_ego[:, :3, 3] *= 1000
    assert "scene 'train-000-downtown', frame 1: its pose jumps: 6000 m/s since the frame before" in problems()


@pytest.mark.parametrize("part", ["pixel_labels", "lidar", "points"])
def test_recorded_labels_beyond_the_classes_of_the_scene_are_refused(tmp_path, part):
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    (recorded,) = world.scenes("train")
    assert getattr(recorded, part)(0) is not None
    classes = recorded.meta["facts"]["spec"]["classes"]
    for number in list(classes)[2:]:
        del classes[number]
    words = r"scene 'train-000-downtown', frame 0: .* of classes \[.*\]; the scene has [01] to 1, and 255 for unknown"
    with pytest.raises(DataError, match=words):
        getattr(recorded, part)(0)


def test_points_that_are_not_finite_are_told():
    problems, _ = check_frame(scene(points=points((np.nan, 0, 0), (3, 0, 0))), expected(), 1)
    assert problems == [
        "scene 'town', frame 1: 1 of its 2 points are not finite; leave out rays that did not come back"
    ]
