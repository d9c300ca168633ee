"""The contract describes inputs and outputs of the program."""

import math

import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.export import contract_of, example_inputs, make_module
from omniocc.model.ops.static import static_shapes


def test_contract_of_a_step(make_model, rig):
    module = make_module(make_model("model/temporal=mean", "model/sketch=random"), rig)
    contract = contract_of(module, WORLD_CLASSES)
    inputs = example_inputs(module)
    assert [port["name"] for port in contract["inputs"]] == ["images", "past_volumes", "past_exists", "world_from_ego"]
    for port, tensor in zip(contract["inputs"], inputs, strict=True):
        assert (tuple(port["shape"]), f"torch.{port['dtype']}") == (tuple(tensor.shape), str(tensor.dtype))
    with static_shapes():
        answer = module(*inputs)
    assert [port["name"] for port in contract["outputs"]] == ["labels", "volume"]
    for port, tensor in zip(contract["outputs"], answer, strict=True):
        assert (tuple(port["shape"]), f"torch.{port['dtype']}") == (tuple(tensor.shape), str(tensor.dtype))
    assert contract["grid"]["shape"] == [16, 20, 4]
    assert contract["grid"]["bounds"][1] == [-math.pi, math.pi]
    assert contract["classes"][0] == "Free"
    assert contract["rig"]["image_size_px"] == [64, 36]


def test_a_model_without_past_takes_images_alone(make_model, rig):
    contract = contract_of(make_module(make_model("model/temporal=none", "model/sketch=random"), rig), WORLD_CLASSES)
    assert [port["name"] for port in contract["inputs"]] == ["images"]
    assert [port["name"] for port in contract["outputs"]] == ["labels"]
    assert contract["outputs"][0]["dtype"] == str(torch.uint8).removeprefix("torch.")
