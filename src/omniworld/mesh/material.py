"""Surface materials; builders of meshes name them, `omniworld.render.texture` paints them."""

from enum import IntEnum


class Material(IntEnum):
    """Material of a surface, which decides its texture and gloss but not its class."""

    ASPHALT = 0
    PAINT = 1
    PAVING = 2
    CONCRETE = 3
    GRASS = 4
    SOIL = 5
    BRICK = 6
    PLASTER = 7
    FACADE = 8  # plaster or brick with rows of windows and doors, by uv
    GLASS = 9
    ROOF = 10
    WOOD = 11
    BARK = 12
    LEAVES = 13
    METAL = 14
    CAR_PAINT = 15
    RUBBER = 16
    CLOTH = 17
    SKIN = 18
    SIGN = 19  # painted metal with a bright face
    LAMP = 20  # gives light
