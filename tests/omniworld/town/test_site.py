"""Land is claimed once, and pieces of a fence follow the land."""

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.shape import Skin, box
from omniworld.town.site import Plan, Pose2, Site
from omniworld.town.terrain import draw


def test_land_is_claimed_once() -> None:
    plan = Plan(50.0)
    house = Pose2(3.0, -4.0, 0.6)
    assert plan.claim(house, (8.0, 6.0))
    assert not plan.claim(house.at(7.0, 0.0), (8.0, 6.0))
    assert not plan.claim(house, (0.5, 0.5))
    assert plan.claim(house.at(9.0, 0.0), (8.0, 6.0))
    plan.block(np.array([[20.0, 20.0]]))
    assert not plan.claim(Pose2(20.0, 20.0, 0.3), (4.0, 0.6))


def test_fences_follow_the_land() -> None:
    land = draw(np.random.default_rng(2), 0.08, 0.0)
    site = Site(land, Plan(100.0))
    fence = box((4, 0.1, 1), (0, 0, 0.5), Skin(4, Material.CONCRETE, (100, 110, 120)))
    for x in np.arange(-40, 40, 4.0):
        site.put(fence, Pose2(float(x), 5.0, 0.0), lift_m=0.0, follow=True)
    mesh = site.mesh()
    foot = mesh.vertices[mesh.vertices[:, 2] - land.height(*mesh.vertices[:, :2].T) < 0.5].astype(float)
    gap = np.abs(foot[:, 2] - land.height(foot[:, 0], foot[:, 1]))
    assert len(foot) == 20 * 4
    assert gap.max() < 0.05
