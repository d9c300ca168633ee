"""Files of predicted voxels carry the class table of their model."""

import numpy as np
import pytest
import torch

from omniocc.classes import ClassTable, SemanticClass
from omniocc.errors import UserError
from omniocc.geometry import Cuboid
from omniocc.predict import PredictedFrame
from omniocc.predict.output.ply import VERTEX
from omniocc.predict.output.voxel_files import read_labels, read_voxels, voxel_arrays, write_mesh, write_voxels

GRID = Cuboid((4, 3, 2), (0.0, 8.0), (-3.0, 3.0), (-1.0, 1.0))
CLASSES = ClassTable(tuple(SemanticClass(k, f"kind{k}", (k, 2 * k, 255 - k)) for k in range(19)))


def prediction() -> PredictedFrame:
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    labels[1, 2, 0] = 18
    return PredictedFrame(labels, labels > 0, None)


def test_nineteen_classes_have_their_own_names_and_colours(tmp_path):
    write_voxels(tmp_path, voxel_arrays(prediction(), GRID, CLASSES, None))
    arrays = np.load(tmp_path / "voxels.npz")
    assert arrays["class_names"].tolist() == list(CLASSES.names)
    assert arrays["class_colors"].tolist() == [list(row.rgb) for row in CLASSES.rows]
    assert "world_from_ego" not in arrays
    write_mesh(tmp_path, prediction().labels, GRID, CLASSES)
    body = (tmp_path / "voxels.ply").read_bytes().partition(b"end_header\n")[2]
    vertex = np.frombuffer(body, VERTEX, 1)[0]
    assert (vertex["red"], vertex["green"], vertex["blue"]) == (18, 36, 237)


def test_labels_are_read_back_and_other_files_refused(tmp_path):
    write_voxels(tmp_path, voxel_arrays(prediction(), GRID, CLASSES, None))
    assert torch.equal(read_labels(tmp_path, GRID), prediction().labels)
    with pytest.raises(UserError, match=r"voxels\.npz.*grid"):
        read_labels(tmp_path, Cuboid((4, 3, 1), GRID.x_m, GRID.y_m, GRID.height_m))
    (tmp_path / "voxels.npz").write_bytes(b"not an archive")
    with pytest.raises(UserError, match=r"voxels\.npz.*damaged"):
        read_labels(tmp_path, GRID)


@pytest.mark.parametrize("wrong", [-1, 19, 3.5, np.nan])
def test_labels_that_are_no_classes_are_refused(tmp_path, wrong):
    arrays = voxel_arrays(prediction(), GRID, CLASSES, None)
    write_voxels(tmp_path, arrays)
    assert torch.equal(read_voxels(tmp_path / "voxels.npz").labels, prediction().labels)
    labels = arrays["labels"].astype(np.float64)
    labels[0, 0, 0] = wrong
    np.savez(tmp_path / "voxels.npz", **arrays | {"labels": labels})
    with pytest.raises(UserError, match=rf"voxels\.npz is damaged .*its labels hold \[{float(wrong)}\]"):
        read_voxels(tmp_path / "voxels.npz")
