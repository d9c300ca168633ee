import itertools
import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder, resample, sample_nearest

FINE = Cuboid((20, 18, 8), (-4.0, 4.0), (-3.6, 3.6), (-1.6, 1.6))
TARGETS = [
    Cuboid((10, 9, 4), (-4.0, 4.0), (-3.6, 3.6), (-1.6, 1.6)),
    Cuboid((7, 5, 3), (-5.0, 3.0), (-2.0, 4.5), (-1.0, 2.2)),
    Cylinder((5, 8, 4), (0.0, 4.5), (-1.6, 2.0)),
]


def random_labels(seed=0):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(1, 5, FINE.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(FINE.shape, generator=generator) < 0.5] = 0
    labels[torch.rand(FINE.shape, generator=generator) < 0.3] = 255
    return labels


def by_definition(labels, source, target, cell, least):
    """Return the label of one target cell, from places two for each length of a source cell."""
    across = min(source.cell_m[:2])
    counts = [
        min(8, math.ceil(2 * size / step - 1e-9))
        for size, step in zip(target.cell_m, (across, across, source.cell_m[2]), strict=True)
    ]
    places = []
    for part in itertools.product(*map(range, counts)):
        place = []
        for axis, (index, share, count) in enumerate(zip(cell, part, counts, strict=True)):
            low, high = target.bounds[axis]
            place.append(low + (index + (share + 0.5) / count) * (high - low) / target.shape[axis])
        places.append(place)
    cells, inside = source.index(target.from_axes(*torch.tensor(places, dtype=torch.float64).unbind(-1)))
    found = [
        int(labels[tuple(where)]) if known else 255
        for where, known in zip(cells.tolist(), inside.tolist(), strict=True)
    ]
    known = [label for label in found if label != 255]
    occupied = [label for label in known if label]
    if occupied and len(occupied) >= least * len(known):
        return max(sorted(set(occupied)), key=occupied.count)
    return 255 if 2 * len(known) < len(found) else 0


@pytest.mark.parametrize("target", TARGETS, ids=str)
@pytest.mark.parametrize("least", [0.4, 0.1])
def test_it_agrees_with_the_definition_cell_by_cell(target, least):
    labels = random_labels()
    found = resample(labels, FINE, target, least)
    assert found.shape == target.shape
    for cell in itertools.product(*map(range, target.shape)):
        assert found[cell] == by_definition(labels, FINE, target, cell, least), cell


def test_the_same_grid_gives_the_labels_themselves():
    labels = random_labels()
    assert resample(labels, FINE, FINE) is labels
    assert sample_nearest(labels[None], FINE, FINE)[0].data_ptr() == labels.data_ptr()


def test_a_grid_moved_by_whole_cells_moves_the_labels():
    labels = random_labels()
    moved = Cuboid(FINE.shape, (-3.6, 4.4), (-4.0, 3.2), (-1.6, 1.6))  # 1 cell ahead, 1 to the right
    found = resample(labels, FINE, moved)
    assert torch.equal(found[:-1, 1:], labels[1:, :-1])
    assert (found[-1] == 255).all()
    assert (found[:, 0] == 255).all()


def test_without_occupied_cells_all_is_free_or_unknown():
    empty = torch.zeros(FINE.shape, dtype=torch.uint8)
    assert (resample(empty, FINE, TARGETS[0]) == 0).all()
    assert (resample(empty + 255, FINE, TARGETS[0]) == 255).all()


def test_predictions_are_looked_up_at_the_middles_and_free_outside():
    coarse = TARGETS[1]
    labels = torch.randint(1, 5, (2, *coarse.shape), generator=torch.Generator().manual_seed(1), dtype=torch.uint8)
    found = sample_nearest(labels, coarse, FINE)
    assert found.shape == (2, *FINE.shape)
    cells, inside = coarse.index(FINE.centers(torch.float64))
    assert not inside.all()
    for sample in range(2):
        expected = labels[sample][tuple(cells.unbind(-1))]
        assert torch.equal(found[sample], torch.where(inside, expected, 0))


def test_labels_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"must have the shape of their grid, \(20, 18, 8\), got \(2, 2, 2\)"):
        resample(torch.zeros(2, 2, 2, dtype=torch.uint8), FINE, TARGETS[0])
