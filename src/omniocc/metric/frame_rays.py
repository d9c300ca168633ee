"""LiDAR rays that every frame has for itself, counted one frame at a time."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric.ray_counts import RayCounts, count_rays


def count_frame_rays(
    geometry: Cylinder | Cuboid,
    prediction: Shaped[Tensor, "X Y Z"],
    range_m: Float[Tensor, " R"],
    labels: Shaped[Tensor, " R"],
    directions: Float[Tensor, "R 3"],
    origins: Float[Tensor, "R 3"],
    num_classes: int,
    thresholds_m: Sequence[float],
    range_edges_m: Sequence[float],
) -> RayCounts:
    """Return the counts of `RayIoU.update_rays` for rays of any origins and directions, those of one frame.

    Args:
        geometry: grid of the prediction.
        prediction: class of every cell.
        range_m: true distance along each ray, m; inf where nothing is hit.
        labels: true class of each hit; free rays and unknown ones (255) do not count.
        directions: unit rays, ego frame.
        origins: where the rays start, m, ego frame.
        num_classes: number of classes, free included.
        thresholds_m: as in `RayIoU`.
        range_edges_m: as in `RayIoU`.
    """
    kept = (labels != FREE) & (labels != UNKNOWN) & range_m.isfinite()
    range_m, labels, directions, origins = range_m[kept].double(), labels[kept], directions[kept], origins[kept]
    found = geometry.cast(prediction.to(torch.uint8), origins, directions)
    error_m = torch.maximum(found.entry_m - range_m, range_m - found.exit_m).clamp(min=0)
    inside = geometry.index(origins.double() + directions.double() * range_m.unsqueeze(-1))[1]
    return count_rays(labels, range_m, found.labels, error_m, inside, num_classes, thresholds_m, range_edges_m)
