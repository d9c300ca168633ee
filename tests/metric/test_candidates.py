import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import CandidateScores

GRID = Cylinder((4, 4, 1), (0.0, 8.0), (0.0, 1.0))
EDGES_M = (0.0, 4.0, 8.0)


def test_by_hand():
    voxels = torch.zeros(1, 4, 4, 1, dtype=torch.uint8)
    candidates = torch.zeros(1, 4, 4, 1, dtype=torch.bool)
    voxels[0, 1] = 7  # four cells in the near band
    voxels[0, 3, :2] = 1  # two in the far band
    voxels[0, 2, :2] = 255
    candidates[0, 1, :3] = True  # three found
    candidates[0, 0, 0] = True  # one wrong
    candidates[0, 2] = True  # two unknown, two wrong
    candidates[0, 3, 0] = True  # one found
    metric = CandidateScores(GRID, EDGES_M)
    metric.update(candidates, voxels)
    scores = {key: value.item() for key, value in metric.compute().items()}
    expected = {
        "recall": 4 / 6,
        "precision": 4 / 7,
        "fraction": 9 / 16,
        "recall_0-4m": 3 / 4,
        "precision_0-4m": 3 / 4,
        "fraction_0-4m": 4 / 8,
        "recall_4-8m": 1 / 2,
        "precision_4-8m": 1 / 3,
        "fraction_4-8m": 5 / 8,
    }
    assert scores == pytest.approx(expected)


@pytest.mark.parametrize("grid", [Cylinder((8, 12, 4)), Cuboid((10, 9, 4))], ids=["cylinder", "cuboid"])
def test_agrees_with_loops_over_batches(grid):
    torch.manual_seed(0)
    voxels = torch.tensor([0, 0, 3, 5, 255], dtype=torch.uint8)[torch.randint(0, 5, (3, *grid.shape))]
    candidates = torch.rand(3, *grid.shape) < 0.4
    edges_m = (2.0, 8.5, 25.6)
    metric = CandidateScores(grid, edges_m)
    metric.update(candidates[:1], voxels[:1])
    metric.update(candidates[1:], voxels[1:])
    scores = metric.compute()
    distance_m = grid.centers(torch.float64)[..., :2].norm(dim=-1)
    for name, low, high in (("", 0, 1e9), ("_2-8.5m", 2, 8.5), ("_8.5-25.6m", 8.5, 25.6)):
        cells = [
            (c, v)
            for sample in range(3)
            for c, v, d in zip(
                candidates[sample].flatten().tolist(),
                voxels[sample].flatten().tolist(),
                distance_m.flatten().tolist(),
                strict=True,
            )
            if low <= d < high
        ]
        found = sum(c and v not in (0, 255) for c, v in cells)
        assert scores["recall" + name].item() == pytest.approx(found / sum(v not in (0, 255) for _, v in cells))
        assert scores["precision" + name].item() == pytest.approx(found / sum(c and v != 255 for c, v in cells))
        assert scores["fraction" + name].item() == pytest.approx(sum(c for c, _ in cells) / len(cells))


def test_parts_of_a_dataset_add_up():
    torch.manual_seed(0)
    voxels = torch.randint(0, 3, (4, *GRID.shape), dtype=torch.uint8)
    candidates = torch.rand(4, *GRID.shape) < 0.5
    whole, left, right = (CandidateScores(GRID, EDGES_M) for _ in range(3))
    whole.update(candidates, voxels)
    left.update(candidates[:1], voxels[:1])
    right.update(candidates[1:], voxels[1:])
    assert left._reductions["counts"] is whole._reductions["counts"]  # processes add their counts
    assert torch.equal(left._reductions["counts"](torch.stack([left.counts, right.counts])), whole.counts)


def test_scores_without_occupied_cells_and_candidates_are_nan():
    metric = CandidateScores(GRID, EDGES_M)
    metric.update(torch.zeros(1, *GRID.shape, dtype=torch.bool), torch.zeros(1, *GRID.shape, dtype=torch.uint8))
    scores = metric.compute()
    assert math.isnan(scores["recall"])
    assert math.isnan(scores["precision"])
    assert scores["fraction"] == 0


def test_error_names_wrong_input():
    metric = CandidateScores(GRID, EDGES_M)
    voxels = torch.zeros(1, *GRID.shape, dtype=torch.uint8)
    with pytest.raises(ValueError, match=r"preds.*bool"):
        metric.update(voxels, voxels)
    with pytest.raises(ValueError, match=r"target.*\(B, 4, 4, 1\).*\(1, 4, 4\)"):
        metric.update(voxels.bool(), voxels[..., 0])
    with pytest.raises(ValueError, match="range_edges_m"):
        CandidateScores(GRID, (8.0, 4.0))
