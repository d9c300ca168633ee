"""Scores: every grid is judged on the same rays, by the classes, bands and rays of the source, where labels exist."""

import dataclasses

import pytest
import torch
from torchmetrics import SumMetric

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.classes import ClassTable, SemanticClass
from omniocc.data.source import Benchmark
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import RayIoU, sparseocc_directions
from omniocc.scores import Scores, within_reach

GRID = Cylinder((8, 12, 4))
FIVE = ClassTable(tuple(SemanticClass(k, f"class{k}", (k, k, k)) for k in range(5)))


@pytest.fixture
def batch():
    """A batch of two samples whose labels are all absent."""
    rig = Rig.load("fisheye6").resized(16, 9)
    images, poses = torch.zeros(2, 1, 6, 3, 9, 16, dtype=torch.uint8), torch.eye(4).double().expand(2, 1, 4, 4)
    return Batch(images, ((rig,),) * 2, poses, ("a/0", "a/1"))


def random_voxels(grid=GRID, classes=12):
    generator = torch.Generator().manual_seed(3)
    occupied = torch.rand(2, *grid.shape, generator=generator) < 0.2
    return (torch.randint(1, classes, (2, *grid.shape), generator=generator) * occupied).to(torch.uint8)


def lidar_hits(directions, classes=12):
    generator = torch.Generator().manual_seed(0)
    range_m = torch.empty(2, len(directions)).uniform_(1, 36, generator=generator)
    hits = torch.randint(0, classes, (2, len(directions)), generator=generator, dtype=torch.uint8)
    return {"lidar_range_m": range_m, "lidar_labels": hits}


def test_hits_beyond_the_reach_count_for_no_grid():
    directions = torch.tensor([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    range_m = torch.tensor([[25.5, 40.0, 25.7]])
    labels = torch.tensor([[4, 5, 6]], dtype=torch.uint8)
    assert within_reach(labels, range_m, directions, 25.6).tolist() == [[4, 5, 0]]
    assert within_reach(labels, range_m, directions, 51.2).tolist() == [[4, 5, 6]]
    origins = torch.tensor([[[-5.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, -1.0, 0.0]]])
    assert within_reach(labels, range_m, directions[None], 25.6, origins).tolist() == [[4, 0, 6]]
    nothing = torch.full((1, 3), torch.inf)  # a frame without a scan, beside one with a scan in its batch
    assert within_reach(torch.full_like(labels, 255), nothing, directions, 25.6).tolist() == [[255] * 3]


def test_cuboid_and_cylinder_are_judged_on_the_same_rays(batch, spec):
    counts = []
    for grid in (GRID, Cuboid((10, 10, 4))):
        scores = Scores(grid, spec)
        labels = torch.zeros(2, *grid.shape, dtype=torch.uint8)
        scores.update(labels, batch._replace(voxels=labels, **lidar_hits(sparseocc_directions())))
        counts.append(scores.lidar.truth)
    assert counts[0].sum() > 1000
    assert torch.equal(counts[0], counts[1])


def test_the_fraction_of_lidar_rays_that_do_not_count(batch, spec):
    """Of four rays of a frame one counts; the fifth, of unknown class and without a range, only fills the batch."""
    ahead = torch.tensor([1.0, 0.0, 0.0]).expand(2, 5, 3)
    range_m = torch.tensor([[7.0, 26.0, 7.0, torch.inf, torch.inf]] * 2)
    hits = torch.tensor([[4, 4, 255, 0, 255]] * 2, dtype=torch.uint8)
    scores = Scores(GRID, dataclasses.replace(spec, lidar_directions=None))
    lidar = {"lidar_range_m": range_m, "lidar_labels": hits, "lidar_directions": ahead}
    scores.update(random_voxels(), batch._replace(lidar_origins=torch.zeros_like(ahead), **lidar))
    found = scores.compute()
    ends = {"": 0.75, "_unknown": 0.25, "_free": 0.5}
    assert {key: value for key, value in found.items() if "left_out" in key} == {
        f"lidar/left_out{end}": value for end, value in ends.items()
    }


def test_absent_labels_have_no_keys(batch, spec):
    labels = random_voxels()
    for given, expected in (
        ({}, set()),
        ({"voxels": labels}, {"rayiou", "voxel/iou"}),
        (lidar_hits(sparseocc_directions()), {"lidar/rayiou"}),
    ):
        scores = Scores(GRID, spec)
        scores.update(labels, batch._replace(**given))
        found = scores.compute()
        assert set(found) & {"rayiou", "lidar/rayiou", "voxel/iou"} == expected
        assert all(not found[key].isnan() for key in expected)
        scores.reset()
        scores.update(labels, batch)
        assert scores.compute() == {}


def test_cells_outside_the_mask_do_not_count(batch, spec):
    truth = random_voxels()
    wrong = truth.clone()
    wrong[..., 2:] = 7
    mask = torch.zeros(2, *GRID.shape, dtype=torch.bool)
    mask[..., :2] = True
    found = []
    for scored in (None, mask):
        scores = Scores(GRID, spec)
        scores.update(wrong, batch._replace(voxels=truth, scored=scored))
        found.append(float(scores.compute()["voxel/iou"]))
    assert found[0] < 0.5
    assert found[1] == 1.0


def test_classes_and_bands_come_from_the_source(batch, spec):
    own = dataclasses.replace(spec, classes=FIVE, range_edges_m=(0.0, 20.0, 40.0))
    scores = Scores(GRID, own)
    labels = random_voxels(classes=5)
    scores.update(labels, batch._replace(voxels=labels))
    found = scores.compute()
    assert {"rayiou/class4", "rayiou_20-40m", "voxel/iou/class1"} <= set(found)
    assert not [key for key in found if "Road" in key or "8.5" in key]
    assert found["voxel/miou"] == 1.0


def test_rays_of_the_frames_count_as_the_same_fixed_rays_do(batch, spec):
    directions = torch.randn(500, 3, generator=torch.Generator().manual_seed(1)) * torch.tensor([1.0, 1.0, 0.1])
    directions = torch.nn.functional.normalize(directions, dim=-1).double()
    hits, labels = lidar_hits(directions), random_voxels()
    fixed = Scores(GRID, dataclasses.replace(spec, lidar_directions=directions))
    fixed.update(labels, batch._replace(**hits))
    own = Scores(GRID, dataclasses.replace(spec, lidar_directions=None))
    spread = directions.float().expand(2, -1, -1)
    own.update(labels, batch._replace(lidar_directions=spread, lidar_origins=torch.zeros_like(spread), **hits))
    expected, found = fixed.compute(), own.compute()
    assert expected["lidar/rayiou@4"] > 0
    assert set(found) == set(expected)
    for key, value in expected.items():
        torch.testing.assert_close(found[key], value, equal_nan=True, rtol=0, atol=1e-6)


def test_rays_start_where_the_frame_says(batch, spec):
    wall = torch.zeros(2, *GRID.shape, dtype=torch.uint8)
    wall[:, 5] = 4  # from 16 to 19.2 m around the ego z axis
    ahead = torch.tensor([1.0, 0.0, 0.0]).expand(2, 1, 3)
    scores = Scores(GRID, dataclasses.replace(spec, lidar_directions=None))
    lidar = {"lidar_range_m": torch.full((2, 1), 7.0), "lidar_labels": torch.full((2, 1), 4, dtype=torch.uint8)}
    origins = torch.tensor([[[10.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]]])
    scores.update(wall, batch._replace(lidar_directions=ahead, lidar_origins=origins, **lidar))
    assert scores.lidar.truth.sum() == 2
    assert scores.lidar.correct[:, 0].sum() == 1


def test_scores_are_given_apart_for_past_present_and_future_origins(batch, spec):
    truth, labels = random_voxels(), random_voxels().roll(1, 1)
    origins = torch.tensor(
        [[[-3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [4.0, 1.0, 0.0]], [[0.0, 0.0, 0.0], *[[torch.nan] * 3] * 2]]
    )
    times = torch.tensor([[-1, 0, 1], [0, 0, 0]])
    scores = Scores(GRID, spec)
    scores.update(labels, batch._replace(voxels=truth, ray_origins=origins, ray_times=times))
    found = scores.compute()
    for time, name in ((-1, "past"), (0, "now"), (1, "future")):
        alone = RayIoU(GRID)
        for sample in range(2):
            chosen = origins[sample][(times[sample] == time) & origins[sample].isfinite().all(-1)]
            if len(chosen):
                alone.update(labels[sample][None], truth[sample][None], chosen[None])
        assert found[f"rayiou_{name}"] == alone.compute()["rayiou"]
    assert scores.protocol()["rayiou"].startswith(
        "14040 rays (39 elevations x 360 azimuths, as SparseOcc) from each of at most 3 origins a frame (where the car "
    )
    scores.reset()
    scores.update(labels, batch._replace(voxels=truth))
    found = scores.compute()
    assert not {"rayiou_past", "rayiou_now", "rayiou_future"} & set(found)
    alone = RayIoU(GRID)
    alone.update(labels, truth)
    assert found["rayiou"] == alone.compute()["rayiou"]


def test_the_protocol_names_what_was_scored(batch, spec):
    labels = random_voxels()
    scores = Scores(GRID, spec)
    assert scores.protocol() == {}
    scores.update(labels, batch._replace(voxels=labels, scored=labels > 0))
    lines = scores.protocol()
    assert set(lines) == {"rayiou", "voxel"}
    assert "from the ego origin" in lines["rayiou"]
    assert "not observed" in lines["rayiou"]
    assert "that are observed" in lines["voxel"]
    scores.update(labels, batch._replace(**lidar_hits(sparseocc_directions())))
    assert "rays measured by a LiDAR" in scores.protocol()["lidar/rayiou"]
    assert scores.protocol()["lidar/rayiou"].endswith(
        "; rays without a return or with a point outside of the grid are free, and so are hits 25.6 m or more from the "
        "ego z axis"
    )
    scores.reset()
    assert scores.protocol() == {}


SMALL = Cuboid((4, 2, 1), (0.0, 8.0), (-4.0, 4.0), (-1.0, 1.0))


@pytest.fixture
def with_part(spec):
    """A source whose benchmark has a near part, the cells (0, 0) and (1, 0)."""
    return dataclasses.replace(spec, benchmark=Benchmark(SMALL, parts=(("near", (0.0, 4.0), (-4.0, 0.0)),)))


def all_but_one() -> tuple[torch.Tensor, torch.Tensor]:
    """Return occupied cells, and predictions that miss (1, 0)."""
    truth = torch.ones(2, *SMALL.shape, dtype=torch.uint8)
    labels = truth.clone()
    labels[:, 1, 0] = 0
    return truth, labels


def test_parts_of_a_benchmark_are_scored_and_merged(batch, with_part):
    truth, labels = all_but_one()
    given = batch._replace(voxels=truth, own_voxels=truth)
    one, two = Scores(SMALL, with_part), Scores(SMALL, with_part)
    one.update(labels, given)
    assert one.compute()["voxel/iou"] == 7 / 8
    assert one.compute()["voxel_near/iou"] == 1 / 2
    two.update(truth, given)
    two.merge(one)
    assert two.compute()["voxel_near/iou"] == 3 / 4


def test_cells_outside_the_mask_do_not_count_in_parts_either(batch, with_part):
    """The cell that is missed is outside of the mask, the other one of the part is left in both samples."""
    truth, labels = all_but_one()
    scores = Scores(SMALL, with_part)
    scores.update(labels, batch._replace(voxels=truth, own_voxels=truth, scored=labels > 0))
    found = scores.compute()
    assert found["voxel/iou"] == found["voxel_near/iou"] == 1.0
    assert scores.parts[0].confusion.sum() == 2


def test_points_at_the_end_of_the_reach_are_beyond_it():
    ahead = torch.tensor([[1.0, 0.0, 0.0]])
    label = torch.tensor([[4]], dtype=torch.uint8)
    assert within_reach(label, torch.tensor([[25.0]]), ahead, 25.0).tolist() == [[0]]


@pytest.mark.parametrize("origins", [False, True], ids=["ego origin", "given origins"])
@pytest.mark.parametrize(
    ("benchmark", "counted"),
    [(None, 1), (Benchmark(GRID), 1), (Benchmark(GRID, masked_rays=False), 2)],
    ids=["own voxels", "masked rays", "rays see all cells"],
)
def test_rays_to_cells_outside_the_mask_count_if_rays_see_all_cells(batch, spec, origins, benchmark, counted):
    """Of two round walls the near one is outside of the first sample's mask, 48 cells.

    All rays that meet a wall meet the near one, so that they count in one sample or in both.
    """
    truth = torch.zeros(2, *GRID.shape, dtype=torch.uint8)
    truth[:, 3], truth[:, 6] = 5, 4
    mask = torch.ones(2, *GRID.shape, dtype=torch.bool)
    mask[0, 3] = False
    given = {"voxels": truth, "own_voxels": truth, "scored": mask}
    if origins:
        given |= {"ray_origins": torch.zeros(2, 1, 3), "ray_times": torch.zeros(2, 1, dtype=torch.int64)}
    scores, one = Scores(GRID, dataclasses.replace(spec, benchmark=benchmark)), RayIoU(GRID)
    scores.update(truth, batch._replace(**given))
    one.update(truth[:1], truth[:1])
    assert scores.rays.truth.sum() == counted * one.truth.sum() > 0
    assert scores.cells.confusion.sum() == 2 * GRID.num_cells - 48


def test_a_metric_that_is_added_is_reset_and_merged_with_the_others(spec):
    ours, theirs = (Scores(GRID, spec) for _ in range(2))
    for scores, value in ((ours, 1.0), (theirs, 3.0)):
        scores.mine = SumMetric()
        scores.mine.update(value)
    ours.merge(theirs)
    assert float(ours.mine.compute()) == 4
    ours.reset()
    assert float(ours.mine.compute()) == 0
