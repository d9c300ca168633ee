"""Exported programs return the labels of their model, also when the number of candidates changes."""

import pytest
import torch

from omniocc.classes import WORLD_CLASSES
from omniocc.errors import UserError
from omniocc.export import contract_of, example_inputs, export_program, make_module
from omniocc.export.files import write_program
from omniocc.model.ops.static import static_shapes

OPTIONS = [
    ["model/temporal=none"],
    ["model/temporal=none", "model.sketch.fraction=0.2", "model.sketch.threshold=null"],
    ["model/temporal=none", "model=extended"],
    ["model/temporal=none", "model/depth=omnimvs3d"],
    ["model/temporal=none", "model/backbone=efficientnet_lite0"],
    ["model/temporal=none", "model/depth=mono"],
    ["model/temporal=none", "model/sketch=random", "model/refiner=attention"],
    [
        "model/temporal=none",
        "model/sketch=dense",
        "model/refiner=none",
        "model.backbone.deformable_stages=[3,4]",
    ],
    ["model/temporal=none", "model=flashocc"],
    ["model/temporal=none", "model=fosocc"],
    ["model/temporal=none", "model=fosocc", "model/geometry=cylinder"],
    ["model/temporal=none", "model=oneocc"],
    ["model/temporal=none", "model=oneocc", "model/geometry=cylinder"],
    ["model/temporal=none", "model=adaptiveocc"],
    ["model/temporal=none", "model=adaptiveocc", "model/geometry=cylinder"],
]
RIVALS = ["flashocc", "fosocc", "oneocc", "adaptiveocc"]


@pytest.mark.parametrize("overrides", OPTIONS, ids=lambda overrides: " ".join(overrides[1:]) or "default")
def test_static_shapes_give_the_same_labels(overrides, make_model, rig, draw_images):
    module = make_module(make_model(*overrides), rig)
    for seed, black in ((0, ()), (1, (2,)), (2, ())):
        images = draw_images(seed, black)
        expected = module(images)
        with static_shapes():
            assert torch.equal(module(images), expected)
    assert len(expected.unique()) > 1


def test_compared_frames_differ_in_the_number_of_candidates(make_model, rig, draw_images):
    sketch = make_model("model/temporal=none").sketch
    images = [draw_images(seed)[None].float() / 255 for seed in (0, 1, 2)]
    counts = {int(sketch(frame, (rig,)).candidates.sum()) for frame in images}
    assert len(counts) > 1


@pytest.mark.slow
def test_a_sequence_gives_the_labels_of_the_model(make_model, rig, draw_images, tmp_path):
    model = make_model("model/temporal=mean")
    module = make_module(model, rig)
    write_program(export_program(module), contract_of(module, WORLD_CLASSES), tmp_path / "model.pt2")
    assert [path.name for path in tmp_path.iterdir()] == ["model.pt2"]
    program = torch.export.load(tmp_path / "model.pt2").module()  # as without this package
    _, volumes, exists, _ = example_inputs(module)
    frames, images, poses = 5, [], torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    poses[:, 0, 3] = torch.arange(frames) * 0.7
    for frame in range(frames):
        newest = draw_images(frame, (1,) if frame == 3 else ())
        images.append(newest)
        window = slice(max(0, frame - 2), frame + 1)
        real = torch.stack(images[window])[None]
        expected = model(real, ((rig,) * real.shape[1],), poses[None, window]).logits.argmax(1)[0]
        first = torch.eye(4, dtype=torch.float64).expand(2 - min(frame, 2), 4, 4)
        labels, volume = program(newest, volumes, exists, torch.cat([first, poses[window]]))
        assert torch.equal(labels, expected.to(torch.uint8))
        volumes = torch.cat([volumes[1:], volume[None]])
        exists = torch.cat([exists[1:], torch.tensor([True])])


@pytest.mark.whole_runs
@pytest.mark.parametrize("name", RIVALS)
def test_rivals_run_as_programs(name, make_model, rig, draw_images, tmp_path):
    module = make_module(make_model(f"model={name}"), rig)
    write_program(export_program(module), contract_of(module, WORLD_CLASSES), tmp_path / "model.pt2")
    program = torch.export.load(tmp_path / "model.pt2").module()
    for seed in (0, 1):
        images = draw_images(seed)
        assert torch.equal(program(images), module(images))


def test_an_option_that_cannot_be_exported_is_named(make_model, rig):
    with pytest.raises(UserError, match=r"model/depth=Sweep"):
        export_program(make_module(make_model("model/temporal=none", "model/depth=sweep"), rig))
    with pytest.raises(UserError, match=r"model/depth=Truth.*recorded range"):
        export_program(make_module(make_model("model/temporal=none", "model/depth=truth"), rig))
