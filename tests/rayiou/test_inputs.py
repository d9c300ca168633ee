"""Metrics take tensors, numpy arrays and lists of any numeric type, and name what is wrong in them."""

import numpy as np
import pytest
import torch
from metric_batches import FORWARD, LINE, METRICS, batch, counted, made, same

from omniocc.metric import CalibrationError, DepthMetrics, RayIoU, RayTruth, VoxelIoU, ray_hits, ray_iou


@pytest.fixture(params=METRICS)
def name(request):
    return request.param


ARRAYS = {
    "plain": lambda array: array,
    "backward": lambda array: array[:, ::-1][:, ::-1],
    "fortran": np.asfortranarray,
    "swapped": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "list": lambda array: array.tolist(),
    "read_only": lambda array: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "kind"),
    [*(("rays", kind) for kind in ARRAYS), *((name, "read_only") for name in METRICS if name != "rays")],
    indirect=["name"],
)
def test_arrays_of_numpy_are_taken(name, kind):
    metric, arrays = made(name), [ARRAYS[kind](part.numpy()) for part in batch(name)]
    metric.update(*arrays)
    same(metric.compute(), counted(name, 0).compute())
    same(made(name)(*arrays), metric.compute())


@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, np.int8, np.float16])
@pytest.mark.parametrize("name", ["rays", "voxels"], indirect=True)
def test_ids_of_any_numeric_type(name, dtype):
    metric = made(name)
    preds, target = (part.numpy().astype(dtype) for part in batch(name))
    mask = target < 9
    metric.update(preds, target, observed=mask)
    expected = made(name)
    expected.update(*batch(name), observed=torch.from_numpy(mask))
    same(metric.compute(), expected.compute())
    for wrong, value in ((np.where(target > 8, 13, target), 13), (np.where(target > 8, 200, target), 200)):
        if np.iinfo(np.int8).max < value and dtype is np.int8:
            continue
        with pytest.raises(ValueError, match=rf"target must hold class ids 0\.\.11 or 255, got \[{value}"):
            metric.update(preds, wrong.astype(dtype))
        with pytest.raises(ValueError, match=rf"preds must hold class ids 0\.\.11, got \[{value}"):
            metric.update(wrong.astype(dtype), target)


def test_arrays_of_rays():
    preds = np.zeros((1, *LINE.shape), np.uint8)
    preds[0, 3] = 4
    metric = RayIoU(LINE, directions=np.array([[1, 0, 0]]), thresholds_m=np.array([1]))
    metric.update_rays(preds, np.array([[4.4]]), [[4]], origins=np.zeros((1, 1, 3)))
    metric.update(preds, RayTruth(np.array([[4.4]]), np.array([[4]]), np.array([[[1.0, 0, 0]]])))
    assert metric.compute()["rayiou"] == 1
    hits = ray_hits(preds[0], LINE, np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))
    assert (hits.cells.item(), hits.exit_m.item()) == (3, 4.0)
    found = ray_iou(preds, preds, LINE, np.zeros((1, 1, 3)), preds < 9, directions=FORWARD.numpy())
    assert found["rayiou/4"] == 1


def test_what_is_no_array_is_named(name):
    preds, target = batch(name)
    for wrong in (["a", "b"], {"a": 1}):
        for arguments, argument in (((wrong, target), "preds"), ((preds, wrong), "target")):
            said = f"{argument} must be a tensor or a numpy array of numbers, got {type(wrong).__name__}"
            with pytest.raises(ValueError, match=said):
                made(name).update(*arguments)


def test_wrong_types_and_shapes_are_named(name):
    preds, target = batch(name)
    for arguments in ((preds.to(torch.complex64), target), (preds, target.to(torch.complex64)), (preds, target[:, 1:])):
        with pytest.raises(ValueError, match=r"^(preds|target) (must|and target must).*got"):
            made(name).update(*arguments)


def test_confidences_outside_of_their_range_are_named():
    with pytest.raises(ValueError, match=r"preds must be confidences in \[0, 1\], got 1.5"):
        CalibrationError().update(torch.tensor([0.5, 1.5]), torch.tensor([True, True]))
    with pytest.raises(ValueError, match=r"preds must be ranges above 0, got -2\.0"):
        DepthMetrics().update(torch.tensor([-2.0]), torch.tensor([3.0]))
    with pytest.raises(ValueError, match="grid must be a grid"):
        VoxelIoU(grid=(8, 12, 4))
