"""Semantic tags of CARLA's server versions, and the classes of the paper that they become.

Tags: LibCarla's `ObjectLabel.h`; they were renumbered in 0.9.14. The grouping follows that of CarlaSC (Wilson et al.,
IEEE RA-L 2022), whose classes the paper shares; road lines stay a class of their own, as in the paper.
"""

import re

import numpy as np
from jaxtyping import UInt8

from omniocc.classes import UNKNOWN, WORLD_CLASSES
from omniocc.errors import UserError

NEW = {
    "Free": (11,),
    "Road": (1,),
    "Sidewalk": (2,),
    "Ground": (10, 25),
    "Building": (3,),
    "Wall": (4, 5, 28),
    "Vegetation": (9,),
    "Vehicle": (14, 15, 16, 17, 18, 19),
    "Other": (20, 21, 22, 23, 26, 27, 29),
    "Pole": (6, 7, 8),
    "Pedestrian": (12, 13),
    "Roadline": (24,),
}
"""Tags of 0.9.14 and later, 0.10 included; sky is free, riders are pedestrians."""
OLD = {
    "Free": (13,),
    "Road": (7,),
    "Sidewalk": (8,),
    "Ground": (14, 22),
    "Building": (1,),
    "Wall": (2, 11, 17),
    "Vegetation": (9,),
    "Vehicle": (10,),
    "Other": (3, 15, 16, 19, 20, 21),
    "Pole": (5, 12, 18),
    "Pedestrian": (4,),
    "Roadline": (6,),
}
"""Tags of 0.9.13 and earlier."""
NEW_SINCE = (0, 9, 14)
ROAD, ROADLINE = (WORLD_CLASSES.names.index(name) for name in ("Road", "Roadline"))


def tags_of(server_version: str) -> dict[str, tuple[int, ...]]:
    """Return the tags of each class in a server's version, such as 0.9.16 or 0.9.15-dirty.

    Raises:
        UserError: if it is no version.
    """
    match = re.match(r"(\d+)\.(\d+)\.?(\d+)?", server_version)
    if match is None:
        raise UserError(f"the server's version is '{server_version}', which is no number like 0.9.16")
    return NEW if tuple(int(part or 0) for part in match.groups()) >= NEW_SINCE else OLD


def class_table(tags: dict[str, tuple[int, ...]]) -> UInt8[np.ndarray, " 256"]:
    """Return our class of every tag: 0 (unlabelled) and tags that are not listed are unknown."""
    table = np.full(256, UNKNOWN, dtype=np.uint8)
    for name, numbers in tags.items():
        table[list(numbers)] = WORLD_CLASSES.names.index(name)
    return table
