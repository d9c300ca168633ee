"""Names of what is on the time line: entity paths, and how names with odd characters go into them."""

from omniocc.geometry import Grid

Path = list[str]
"""Parts of an entity path; each may hold any characters, which Rerun escapes."""

WORLD: Path = ["world"]
EGO: Path = ["world", "ego"]
"""Everything below moves with the car."""
TRAJECTORY: Path = [*WORLD, "trajectory"]
CAMERAS: Path = [*EGO, "cameras"]
LIDAR: Path = [*EGO, "lidar"]
VOXELS: Path = [*EGO, "voxels"]
DIFFERENCES: Path = [*EGO, "differences"]
CANDIDATES: Path = [*EGO, "candidates"]
RAYS: Path = [*EGO, "rays"]
POINTS: Path = [*EGO, "points"]
IMAGES: Path = ["images"]
RANGES: Path = ["ranges"]
FIGURES: Path = ["figures"]
DESCRIPTION: Path = ["frame"]
TRUTH = "truth"


def grid_name(grid: Grid) -> str:
    """Return a grid in words, such as `cylinder 64x100x8`."""
    return f"{type(grid).__name__.lower()} {'x'.join(map(str, grid.shape))}"


def truth_name(grid: Grid) -> str:
    """Return the name of the true voxels of a grid, beside the names of models."""
    return f"{TRUTH}, {grid_name(grid)}"


def model_name(name: str) -> str:
    """Return the name of a model on the time line; none is called as the truth is."""
    return f"model {name}" if name.startswith(TRUTH) else name
