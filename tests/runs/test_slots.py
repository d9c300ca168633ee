import pytest

from omniocc.runs.slots import option_of, slots_line, slots_of


@pytest.mark.parametrize(
    ("target", "option"),
    [
        ("omniocc.model.sketch.Omni", "omni"),
        ("omniocc.model.refiner.NoRefiner", "none"),
        ("omniocc.model.lifter.LiftSplat", "lift_splat"),
        ("omniocc.geometry.Cylinder", "cylinder"),
        ("torch.nn.Linear", "Linear"),
    ],
)
def test_an_option_has_the_name_of_its_file(target, option):
    assert option_of({"_target_": target}) == option


def test_slots_are_the_parts_of_the_model():
    depth = {"_target_": "omniocc.model.depth.Sweep"}
    model = {
        "_target_": "omniocc.model.OccupancyModel",
        "num_classes": 12,
        "geometry": {"_target_": "omniocc.geometry.Cuboid"},
        "sketch": {"_target_": "omniocc.model.sketch.Omni"},
    }
    assert slots_of({"model": model, "depth": depth}) == {"geometry": "cuboid", "sketch": "omni", "depth": "sweep"}
    model["sketch"] = {"_target_": "omniocc.model.sketch.Dense"}
    assert slots_of({"model": model, "depth": depth}) == {"geometry": "cuboid", "sketch": "dense"}


@pytest.mark.parametrize(("switches", "option"), [((False, False), "none"), ((False, True), "sketch_and_pixels")])
def test_hints_that_are_all_off_are_the_option_none(switches, option):
    hints = {
        "_target_": "omniocc.model.hints.SketchAndPixels",
        **dict(zip(("queries", "volume"), switches, strict=True)),
    }
    sketch = {"_target_": "omniocc.model.sketch.Dense"}
    assert slots_of({"model": {"hints": hints, "sketch": sketch}, "depth": {}})["hints"] == option


def test_a_line_names_the_parts_and_the_voxels():
    model = {
        "geometry": {"_target_": "omniocc.geometry.Cylinder", "shape": [4, 6, 2]},
        "sketch": {"_target_": "omniocc.model.sketch.Dense"},
    }
    assert slots_line({"model": model}) == "geometry=cylinder, sketch=dense; 4x6x2 voxels"
