"""The surfaces of a place: carriageways, kerbs, sidewalks, the land inside and outside the blocks."""

import numpy as np

from omniocc.seeding import choice
from omniworld.mesh.label import GROUND, ROAD, SIDEWALK
from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate
from omniworld.mesh.shape import Skin, fan, sheet
from omniworld.town.line import arc_lengths
from omniworld.town.network import Network, Ring
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

CROWN_M = 0.10  # a street's middle above its kerbs
KERB_M = 0.13
_KERB_STONE_M = 0.16


def build(theme: Theme, terrain: Terrain, network: Network, paved: tuple[bool, ...], rng: np.random.Generator) -> Mesh:
    """Build all surfaces; `paved` tells which blocks have a sidewalk instead of a verge."""
    material, dark, light = theme.road
    shade = int(rng.integers(dark, light))
    asphalt = Skin(ROAD, material, (shade, shade, shade + 3))
    meshes = []
    for ring, has_sidewalk in zip(network.rings, paved, strict=True):
        kerb, inner = terrain.points(ring.kerb_m), terrain.points(ring.inner_m, CROWN_M)
        meshes.append(_surface([inner, kerb], asphalt))
        meshes.append(_edge(theme, terrain, ring, kerb, has_sidewalk, rng))
        meshes.append(_land(theme, terrain, ring, rng))
    return concatenate(meshes)


def _surface(rows: list[np.ndarray], skin: Skin) -> Mesh:
    """Build a band between closed rows of points, uv = world x and y."""
    net = np.stack([np.concatenate([row, row[:1]]) for row in rows])
    return sheet(net, net[..., :2], skin)


def _edge(theme: Theme, terrain: Terrain, ring: Ring, kerb: np.ndarray, paved: bool, rng: np.random.Generator) -> Mesh:
    """Build kerb face, kerb stone and sidewalk, or a verge of the same shape."""
    rows = [terrain.points(ring.offset(from_kerb_m), KERB_M) for from_kerb_m in (0.0, _KERB_STONE_M, theme.sidewalk_m)]
    closed = np.stack([np.concatenate([row, row[:1]]) for row in (kerb, rows[0])])
    face_uv = np.stack(np.meshgrid(arc_lengths(closed[0]), [0, KERB_M]), -1)
    if paved:
        shade = int(rng.integers(120, 172))
        stone = Skin(SIDEWALK, Material.CONCRETE, (170, 168, 162))
        walk = Skin(
            SIDEWALK, Material.PAVING, (shade, shade - int(rng.integers(0, 12)), shade - int(rng.integers(4, 22)))
        )
    else:
        stone = walk = Skin(GROUND, Material.GRASS, (96, 116, 60))
    return concatenate([sheet(closed, face_uv, stone), _surface(rows[:2], stone), _surface(rows[1:], walk)])


def _land(theme: Theme, terrain: Terrain, ring: Ring, rng: np.random.Generator) -> Mesh:
    """Build the land from the back of the sidewalk to the middle of the block, or to the horizon."""
    rim = ring.offset(theme.sidewalk_m)
    middle = np.zeros(2) if ring.outside else rim.mean(0)
    fractions = (1.0, 1.12, 1.4, 2.0, 3.0, 5.0) if ring.outside else (1.0, 0.75, 0.45)
    rows = [terrain.points(middle + fraction * (rim - middle), KERB_M) for fraction in fractions]
    material, color = choice(rng, theme.ground)
    varied = np.clip(np.asarray(color) + rng.integers(-8, 9, 3), 0, 255)
    skin = Skin(GROUND, material, (int(varied[0]), int(varied[1]), int(varied[2])))
    far = Skin(GROUND, Material.GRASS, (92, 112, 66))
    if ring.outside:
        return concatenate([_surface(rows[:3], skin), _surface(rows[2:], far)])
    return concatenate([_surface(rows, skin), fan(rows[-1], skin)])
