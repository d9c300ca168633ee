"""First hits of rays, for other metrics and other programs."""

import torch
from jaxtyping import Float, Shaped

from rayiou.checks import Array, as_tensors, check_origins
from rayiou.class_ids import ClassIds
from rayiou.cuboid import Cuboid
from rayiou.cylinder import Cylinder
from rayiou.labels import FREE, NUM_CLASSES, UNKNOWN
from rayiou.ray_counter import scan_of
from rayiou.raycast.table import ray_table
from rayiou.raycast.trace import Hits


def ray_hits(
    labels: Shaped[Array, "X Y Z"],
    grid: Cylinder | Cuboid,
    origins: Float[Array, "O 3"] | None = None,
    directions: Float[Array, "D 3"] | None = None,
    num_classes: int = NUM_CLASSES,
    free_index: int = FREE,
    ignore_index: int = UNKNOWN,
) -> Hits:
    """Return range, class and cell of the first hit of each ray in one label volume, as RayPQ needs them.

    Args:
        labels: class of every cell, or `ignore_index`, which stops a ray as well.
        grid: grid of the labels.
        origins: starts of the rays, ego frame, metres; default the ego origin.
        directions: of the rays from every origin; default `sparseocc_directions()`.
        num_classes: number of classes, free included.
        free_index: id of free space, and of rays without a hit.
        ignore_index: id of unknown cells.

    Returns:
        All rays from the first origin, then those from the next. `cells` indexes the flattened volume, so instance ids
        of hits are `instances.flatten()[hits.cells]` where `hits.cells >= 0`.

    Raises:
        ValueError: naming a wrong shape, type or value.

    Example:
        >>> grid = Cuboid((10, 1, 1), (0.0, 10.0), (-0.5, 0.5), (-0.5, 0.5))
        >>> labels = torch.zeros(10, 1, 1, dtype=torch.uint8)
        >>> labels[3] = 4
        >>> hits = ray_hits(labels, grid, directions=torch.tensor([[1.0, 0.0, 0.0]]))
        >>> hits.labels.item(), hits.cells.item(), hits.entry_m.item(), hits.exit_m.item()
        (4, 3, 3.0, 4.0)
    """
    classes = ClassIds(num_classes, free_index, ignore_index)
    labels, origins = as_tensors("cpu", labels=labels, origins=origins)
    checked = classes.check("labels", labels.unsqueeze(0), grid.shape, truth=True)[0]
    starts = torch.zeros(1, 3) if origins is None else origins
    check_origins("origins", starts)
    hits = ray_table(grid, starts.to(labels.device), scan_of(directions)).cast(checked - free_index)
    return hits._replace(labels=hits.labels + free_index)
