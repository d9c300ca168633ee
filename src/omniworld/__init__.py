"""The virtual world: procedural places, traffic in them, and recordings of it by cameras and LiDARs.

Layers: mesh < assets < town < traffic, and assets < render < sensors; `scene` puts them together, `source` is the data
source of training.
"""

from omniocc.frame import Box, Frame
from omniworld.scene import Scene
from omniworld.source import VirtualWorld
from omniworld.town.place import ABSTRACT, THEMES

__all__ = ["ABSTRACT", "THEMES", "Box", "Frame", "Scene", "VirtualWorld"]
