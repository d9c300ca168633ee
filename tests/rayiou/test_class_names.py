"""Keys of the scores for datasets with other classes."""

import pytest
import torch

from omniocc.geometry import Cuboid
from omniocc.metric import RayIoU, VoxelIoU, ray_iou

GRID = Cuboid((4, 1, 1), (0.0, 4.0), (-0.5, 0.5), (-0.5, 0.5))
FORWARD = torch.tensor([[1.0, 0.0, 0.0]])
NAMES = tuple(f"class{label}" for label in range(17))


def labels():
    result = torch.zeros(1, *GRID.shape, dtype=torch.uint8)
    result[0, 2] = 16
    return result


def class_keys(scores, prefix):
    return [key.removeprefix(prefix) for key in scores if key.startswith(prefix)]


def test_names_of_seventeen_classes_are_the_keys():
    rays = RayIoU(GRID, num_classes=17, directions=FORWARD, class_names=NAMES)
    voxels = VoxelIoU(num_classes=17, class_names=NAMES)
    for metric, prefix in ((rays, "rayiou/"), (voxels, "iou/")):
        metric.update(labels(), labels())
        assert class_keys(metric.compute(), prefix) == list(NAMES[1:])
        assert metric.compute()[f"{prefix}class16"] == 1
    assert ray_iou(labels(), labels(), GRID, num_classes=17, class_names=NAMES)["rayiou/class16"] == 1


def test_free_class_has_no_key():
    metric = VoxelIoU(num_classes=17, free_index=3, class_names=NAMES)
    assert class_keys(metric.compute(), "iou/") == [*NAMES[:3], *NAMES[4:]]


@pytest.mark.parametrize(("num_classes", "expected"), [(12, [str(c) for c in range(1, 12)]), (4, ["1", "2", "3"])])
def test_ids_are_the_names_of_classes_without_names(num_classes, expected):
    assert class_keys(RayIoU(GRID, num_classes=num_classes).compute(), "rayiou/") == expected
    assert class_keys(VoxelIoU(num_classes).compute(), "iou/") == expected
    volumes = torch.zeros(1, *GRID.shape, dtype=torch.uint8)
    assert class_keys(ray_iou(volumes, volumes, GRID, num_classes=num_classes), "rayiou/") == expected


@pytest.mark.parametrize("names", [NAMES[:16], ("same",) * 17])
def test_error_for_missing_and_repeated_names(names):
    for build in (lambda: VoxelIoU(17, class_names=names), lambda: RayIoU(GRID, 17, class_names=names)):
        with pytest.raises(ValueError, match="class_names must be 17 different names"):
            build()
