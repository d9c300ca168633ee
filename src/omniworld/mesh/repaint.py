"""New materials and colours for a whole mesh, so that nothing can be recognised by its looks."""

from dataclasses import replace

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh

_PLAIN = (Material.GLASS, Material.LAMP)  # without texture


def repaint(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Return the mesh with every material exchanged for another, and all colours mixed anew; lamps stay lamps."""
    textured = np.array([material for material in Material if material not in _PLAIN])
    exchanged = rng.choice(textured, len(Material)).astype(np.uint8)
    exchanged[Material.LAMP] = Material.LAMP
    mix = rng.normal(0, 0.6, (len(Material), 3, 3)) + 0.4 * np.eye(3)
    shift = rng.uniform(20, 180, (len(Material), 3))
    color = np.empty((len(mesh), 3), np.uint8)
    for material in np.unique(mesh.material):
        own = mesh.material == material
        color[own] = np.clip(mesh.color[own] @ mix[material].T + shift[material], 15, 245)
    return replace(mesh, material=exchanged[mesh.material], color=color)
