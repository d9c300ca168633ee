"""RayIoU and voxel IoU of semantic occupancy on any voxel grid, as torchmetrics metrics; ray casting through voxels.

The package needs torch, torchmetrics, numba and jaxtyping. It contains no code for a dataset or a camera.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.directions import RayOrigins, sparseocc_directions, sparseocc_origins, trajectory_origins
from rayiou.first_hits import ray_hits
from rayiou.grid import Grid
from rayiou.raycast.fans import RayFans, RayScan
from rayiou.raycast.table import RayTable, ray_table
from rayiou.raycast.trace import Hits, RayPaths
from rayiou.resample import center_cell_indices, resample, sample_nearest
from rayiou.vote import downsample, majority_vote

if TYPE_CHECKING:
    from rayiou.ray_metric import RayIoU, RayTruth, ray_iou
    from rayiou.voxel_iou import VoxelIoU

LAZY_MODULES = {
    "RayIoU": "ray_metric",
    "RayTruth": "ray_metric",
    "VoxelIoU": "voxel_iou",
    "ray_iou": "ray_metric",
}
"""Names that are imported at their first use, with their modules: the import of torchmetrics takes a second."""

__all__ = [
    "Cuboid",
    "Cylinder",
    "Grid",
    "Hits",
    "RayFans",
    "RayIoU",
    "RayOrigins",
    "RayPaths",
    "RayScan",
    "RayTable",
    "RayTruth",
    "VoxelIoU",
    "center_cell_indices",
    "downsample",
    "majority_vote",
    "ray_hits",
    "ray_iou",
    "ray_table",
    "resample",
    "sample_nearest",
    "sparseocc_directions",
    "sparseocc_origins",
    "trajectory_origins",
]


def __getattr__(name: str) -> Any:
    """Import a name of `LAZY_MODULES`."""
    if name in LAZY_MODULES:
        return getattr(import_module(f"rayiou.{LAZY_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
