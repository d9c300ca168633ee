"""Procedural textures: `pattern` paints one per material (PAINTERS), `facade` those of house fronts.

`atlas` packs them with mip levels, and looks them up.
"""
