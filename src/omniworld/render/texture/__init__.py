"""Procedural textures: `pattern` paints one per material (PAINTERS).

`atlas` paints those of house fronts and packs all with mip levels.
"""
