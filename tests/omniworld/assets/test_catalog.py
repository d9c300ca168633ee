"""Prototypes: every kind can be built, touches the ground, and has the class of its group."""

import numpy as np
import pytest

from omniworld.assets import barrier, building, catalog, pole, prop, tree, vehicle
from omniworld.mesh import label

_CLASS = {
    "tree": (tree, label.VEGETATION),
    "barrier": (barrier, label.WALL),
    "prop": (prop, label.OTHER),
    "pole": (pole, label.POLE),
    "vehicle": (vehicle, label.VEHICLE),
    "building": (building, label.BUILDING),
}


@pytest.mark.parametrize("group", _CLASS)
def test_every_kind_is_built_in_its_class(group: str) -> None:
    module, group_class = _CLASS[group]
    for kind in module.KINDS:
        expected = {label.VEGETATION} if kind == "hedge" else {group_class}
        for mesh in catalog.variants(group, kind):
            assert set(np.unique(mesh.label)) == expected, kind
            assert mesh.vertices[:, 2].min() <= 0.5, kind
            assert mesh.vertices[:, 2].max() > 0.3, kind


def test_a_fitting_building_fills_its_land() -> None:
    for size_m in ((10.0, 9.0), (22.0, 14.0)):
        mesh, stretch = catalog.fitting_building(np.random.default_rng(0), "tower", size_m)
        np.testing.assert_allclose(np.array(building.footprint_m(mesh)) * stretch, size_m, rtol=1e-5)
