"""How scores were counted, in one line that stands under every table: rays, origins, thresholds, masks, classes."""

from collections.abc import Sequence
from dataclasses import dataclass

from rayiou.class_ids import ClassIds


@dataclass(frozen=True)
class RaysSeen:
    """What a metric of rays was given so far.

    Attributes:
        given: whether it was given anything.
        measured: whether the truth was measured by a LiDAR.
        own_rays: whether every frame had rays of its own.
        origins: largest number of origins of a frame; 0: no origins were given.
        timed: whether these were those of past, present and future frames.
        masked: whether cells were left out as not observed.
    """

    given: bool = False
    measured: bool = False
    own_rays: bool = False
    origins: int = 0
    timed: bool = False
    masked: bool = False


def rays_text(rays: int, public: bool, seen: RaysSeen) -> str:
    """Return the number of rays and from where they start."""
    if seen.own_rays:
        return "rays measured by a LiDAR, from where it was"
    kind = f"{rays} rays" + (" (39 elevations x 360 azimuths, as SparseOcc)" if public else "")
    kind += " measured by a LiDAR" if seen.measured else ""
    if not seen.origins:
        return f"{kind} from the ego origin"
    where = "where the car was in past, present and future frames" if seen.timed else "given origins"
    number = "1 origin" if seen.origins == 1 else f"at most {seen.origins} origins"
    return f"{kind} from each of {number} a frame ({where})"


def error_text(thresholds_m: Sequence[float], fine_m: Sequence[float], hit: str, seen: RaysSeen) -> str:
    """Return when a ray is correct, for the mean and for the scores called fine."""
    thresholds, fine = (", ".join(f"{threshold_m:g}" for threshold_m in part) for part in (thresholds_m, fine_m))
    side = "leaves" if hit == "exit" else "enters"
    between = "from the measured point to the predicted cell" if seen.measured else f"where the ray {side} its cell"
    extra = f" (fine: {fine} m)" if fine else ""
    return f"correct: same class, error below {thresholds} m{extra} {between}"


def dropped_text(classes: ClassIds, count_free_rays: bool, masked: bool) -> str:
    """Return which rays do not count."""
    unknown = f"unknown ({classes.ignored})" + (" or in a cell that is not observed" if masked else "")
    return f"rays count whose truth is not {unknown}" + ("" if count_free_rays else " or free")


def free_text(seen: RaysSeen) -> list[str]:
    """Return which rays are free, where the truth was measured; this part is last, as records of before lack it."""
    return ["rays without a return or with a point outside of the grid are free"] if seen.measured else []


def mean_text(classes: ClassIds) -> str:
    """Return over what the mean runs."""
    return f"mean over thresholds and the classes that occur, of {len(classes.occupied)} without free"


def cells_text(classes: ClassIds, weighted: bool, masked: bool) -> str:
    """Return which cells count for the scores of voxels, and how."""
    known = f"cells count whose truth is not unknown ({classes.ignored})" + (" and that are observed" if masked else "")
    weight = "weighed by volume" if weighted else "each once"
    return f"{known}, {weight}; mIoU: mean over the classes that occur, of {len(classes.occupied)} without free"
