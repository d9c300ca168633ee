"""Class ids of the faces of meshes, by name: the same numbers as in `omniocc.classes`."""

from omniocc.classes import CLASSES

ROAD, SIDEWALK, GROUND, BUILDING, WALL, VEGETATION, VEHICLE, OTHER, POLE, PEDESTRIAN, ROADLINE = (
    row.id for row in CLASSES[1:]
)
