"""What a lifter takes cameras for: what they are, or pinholes, to measure what the true lens model is worth."""

from typing import Literal

from omniocc.camera import Rig
from omniocc.camera.pinholes import as_pinholes
from omniocc.model.ops.rig_cache import once_per_rig

Lens = Literal["own", "pinhole"]
_as_pinholes = once_per_rig(as_pinholes)


def taken_for(lens: Lens, rigs: tuple[Rig, ...]) -> tuple[Rig, ...]:
    """Return the rigs as they are (`own`), or with every camera taken for a pinhole, which is wrong for others."""
    return rigs if lens == "own" else tuple(map(_as_pinholes, rigs))
