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
    """Return distances, class and cell of the first hit of each ray in one label volume.

    Other metrics, such as RayPQ, compare these hits.

    Args:
        labels: class of every cell; `ignore_index` marks an unknown cell, which also stops a ray.
        grid: grid of the labels.
        origins: where rays start, m, in the ego frame; by default the ego origin alone.
        directions: of the rays, the same from every origin; by default `sparseocc_directions()`.
        num_classes: number of classes, free included.
        free_index: id of free space, and of rays without a hit.
        ignore_index: id of unknown cells.

    Returns:
        The hits of all rays from the first origin, then the hits from the next one. `cells` indexes the flattened
        volume, -1 without a hit: `instances.flatten()[hits.cells]` are the instance ids where `hits.cells >= 0`.

    Raises:
        ValueError: when an argument has a wrong shape, type or value.

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
    # labels may hold `ignore_index`, which `check` accepts of a truth alone
    checked = classes.check("labels", labels.unsqueeze(0), grid.shape, truth=True)[0]
    starts = torch.zeros(1, 3) if origins is None else origins
    check_origins("origins", starts)
    # `cast` takes 0 as free; in uint8 the difference wraps around, and the sum below undoes it
    hits = ray_table(grid, starts.to(labels.device), scan_of(directions)).cast(checked - free_index)
    return hits._replace(labels=hits.labels + free_index)
