import pytest
import torch
from batches import RIG, make_batch

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre
from omniocc.classes import FREE, UNKNOWN
from omniocc.model.ops.evidence import pack_evidence
from omniocc.model.protocols import Sketched
from omniocc.train.audit import Audit, Overlap, RangeErrors, pairs_without_label, with_true_classes, with_true_geometry


def test_geometry_and_classes_are_exchanged_one_at_a_time():
    truth = torch.tensor([[[[0, 3, 3, 255, 2]]]], dtype=torch.uint8)
    labels = torch.tensor([[[[1, 1, 0, 2, 2]]]], dtype=torch.uint8)
    logits = torch.nn.functional.one_hot(labels.long(), 4).movedim(-1, 1).float()
    logits[:, 2] += 0.1  # the second best class
    assert with_true_geometry(logits, truth).flatten().tolist() == [0, 1, 2, 0, 2]
    assert with_true_classes(labels, truth).flatten().tolist() == [1, 3, 0, 2, 2]


def test_overlap_is_intersection_over_union_precision_and_recall():
    overlap = Overlap()
    assert not overlap.filled
    truth = torch.tensor([[[[0, 3, 3, 255, 2, 1]]]], dtype=torch.uint8)
    overlap.update(torch.tensor([[[[1, 1, 0, 1, 1, 0]]]]).bool(), truth)
    assert overlap.text() == "0.400 (0.667, 0.500)"


def test_pairs_on_pixels_without_a_label_are_found(make_task):
    geometry = make_task("model/sketch=dense").model.geometry
    labels = torch.zeros(6, 36, 64, dtype=torch.uint8)
    assert not pairs_without_label(RIG, geometry, labels).any()
    labels[2] = UNKNOWN
    pairs = pairs_without_label(RIG, geometry, labels)
    seen = RIG.project(geometry.centers(torch.float64).reshape(-1, 3))[1].sum(1)
    assert pairs.sum() == seen[2]
    assert len(pairs) == seen.sum()
    assert pairs_without_label(Rig.load("fisheye6").resized(64, 36), geometry, labels).mean() < 1 / 3
    padded = torch.cat([labels, torch.full_like(labels[:2], UNKNOWN)])  # beside a rig of eight cameras
    assert torch.equal(pairs_without_label(RIG, geometry, padded), pairs)


def test_a_perfect_prediction_loses_nothing(make_task, spec):
    task = make_task("model/sketch=omni")
    batch = make_batch(task, ((0, 1), (1, 0)))
    logits = 9 * torch.nn.functional.one_hot(batch.voxels.long(), 12).movedim(-1, 1).float()
    audit = Audit(task.model.geometry, spec)
    occupied = (batch.voxels != FREE).float()
    bits = pack_evidence(torch.logit(0.1 + 0.8 * occupied), occupied.to(torch.uint8))
    audit.update(logits, Sketched(batch.candidates[:, -1], bits), batch)
    lines = dict(audit.lines())
    for variant in ("of the model", "with true geometry", "with true classes"):
        assert lines[f"RayIoU {variant}"] == "1.000"
    assert lines["voxel IoU (precision, recall) of the model"] == "1.000 (1.000, 1.000)"
    assert lines["voxel IoU (precision, recall) of the sketch at 0.5"] == "1.000 (1.000, 1.000)"
    assert lines["voxel IoU (precision, recall) of the sketch at 0.08"].endswith("1.000)")
    top, accuracy = map(float, lines["mean top probability, accuracy"].split(", "))
    assert accuracy == 1
    assert "(voxel, camera) pairs on pixels without a label" in lines
    assert top == pytest.approx(1, abs=2e-3)


def test_labels_are_those_of_the_test(make_task, spec):
    """A cell that is occupied with a probability of a third is so above a quarter."""
    task = make_task("model/sketch=omni")
    batch = make_batch(task, ((0, 1), (1, 0)))
    truth = torch.nn.functional.one_hot(batch.voxels.long(), 12).movedim(-1, 1).float()
    logits = (0.3 * truth + 1e-6).log()
    logits[:, FREE] = torch.where(batch.voxels == FREE, 0.0, torch.tensor(0.6).log())
    for above, score in ((None, "0.000"), (0.25, "1.000")):
        audit = Audit(task.model.geometry, spec, above)
        audit.update(logits, Sketched(batch.candidates[:, -1], None), batch)
        assert dict(audit.lines())["RayIoU of the model"] == score


def test_errors_of_range_are_in_metres_and_in_pixels_of_parallax():
    panorama, errors = Equirectangular(36, 4, 20.0, -20.0), RangeErrors([0.0, 10.0, 20.0])
    true_m = torch.full((4, 36), 5.0)
    true_m[0], true_m[1, :18], true_m[1, 18:] = 15.0, float("inf"), float("nan")
    true_m[2] = 30.0  # beyond all bands
    rig = Rig.load("fisheye6")
    errors.update(true_m + 0.1 * (true_m == 15) - 0.2 * (true_m == 5), true_m, panorama, rig)
    lines = dict(errors.lines())
    assert list(lines) == ["error of range, 0-10m", "error of range, 10-20m"]
    for name, row, distance_m, error_m in (("0-10m", 3, 5.0, 0.2), ("10-20m", 0, 15.0, 0.1)):
        px_per_m = pixels_per_metre(rig, panorama.rays()[row] * distance_m)
        seen = px_per_m > 0
        share, pixels = seen.double().mean(), (px_per_m * error_m).sum() / seen.sum()
        text = f"{error_m:.3f} m; seen by two cameras {share:.0%}, there {error_m:.3f} m or {pixels:.2f} px"
        assert lines[f"error of range, {name}"] == text


def test_without_classes_of_pixels_nothing_is_said_about_them(make_task, spec):
    task = make_task("model/sketch=dense")
    batch = make_batch(task, ((0, 1), (1, 0)))
    audit = Audit(task.model.geometry, spec)
    logits = torch.zeros(len(batch.voxels), 12, *task.model.geometry.shape)
    audit.update(logits, Sketched(torch.ones_like(batch.voxels, dtype=torch.bool)), batch._replace(pixel_labels=None))
    assert not [name for name, _ in audit.lines() if "pixels" in name]
