"""The examples in docstrings print the results that they show."""

import doctest
import importlib
import pkgutil

import pytest

import omniocc.metric
import rayiou

MODULES = [
    module.name
    for package in (rayiou, omniocc.metric)
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + ".")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_the_public_names_have_examples():
    finder = doctest.DocTestFinder(recurse=False)
    names = ("RayIoU", "VoxelIoU", "DepthMetrics", "ray_iou", "ray_hits", "sparseocc_origins", "trajectory_origins")
    public = [getattr(omniocc.metric, name) for name in names] + [rayiou.Grid.trace]
    for thing in public:
        assert any(test.examples for test in finder.find(thing, globs={})), thing
