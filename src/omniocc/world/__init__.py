"""The virtual world: procedural places, traffic in them, and recordings of it by cameras and LiDARs.

Layers: mesh < assets < town < traffic, and assets < render < sensors; `scene` puts them together.
"""

from omniocc.world.frame import Box, Frame
from omniocc.world.scene import Scene
from omniocc.world.town.place import ABSTRACT, THEMES

__all__ = ["ABSTRACT", "THEMES", "Box", "Frame", "Scene"]
