"""Camera-based 3D semantic occupancy for vehicles with fisheye cameras."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniocc.predict.trained import load as load

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Return `load`, whose module is imported when it is asked for: it takes seconds, and the metrics do without."""
    if name != "load":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from omniocc.predict.trained import load

    return load
