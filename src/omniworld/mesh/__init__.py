"""Triangle meshes, which all of the world is made of.

`mesh` has the arrays, `shape` simple solids, `material` the surface materials, `label` the class ids.
"""
