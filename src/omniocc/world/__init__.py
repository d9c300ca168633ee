"""The virtual world: procedural places, traffic in them, and everything that cameras and LiDARs record there."""

from omniocc.world.frame import Box, Frame
from omniocc.world.scene import Scene
from omniocc.world.town.place import THEMES

__all__ = ["THEMES", "Box", "Frame", "Scene"]
