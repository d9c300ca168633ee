"""Configuration: every problem is found before anything is built, and named."""

import inspect
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.utils import get_object
from lightning.pytorch import seed_everything
from omegaconf import OmegaConf

from omniocc.bounds import Count, Kept, Rate, Weight, fits
from omniocc.config import ConfigError, build, check, check_root, compose_plain, parameters_of, plain, quoted
from omniocc.geometry import Cylinder
from omniocc.runs.folder import run_hash
from omniocc.train.stage_keys import stage_keys

CONF = Path(__file__).parents[1] / "conf"
OTHERS = ("preset", "ablation", "demo", "adapt", "trainer", "hydra")
"""Folders whose files are no options of a slot."""
LINK = CONF / "appearance" / "disturbed.yaml"
"""It takes all of another option."""
OPTIONS = sorted(
    path for path in CONF.rglob("*.yaml") if path.parent != CONF and path.parts[len(CONF.parts)] not in OTHERS
)
OPTIONS.remove(LINK)


def loaded(path: Path) -> dict:
    """An option as it stands in its file, on top of the option of the same slot that it starts from."""
    node = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    for entry in node.get("defaults", []):
        if isinstance(entry, str) and entry != "_self_":
            node = loaded(path.with_name(f"{entry}.yaml")) | node
    return node.get("model", {}) | node if path.parent == CONF / "model" else node  # which begins at the root


@pytest.mark.parametrize("path", OPTIONS, ids=lambda path: str(path.relative_to(CONF)))
def test_every_option_lists_exactly_the_arguments_of_its_class(path):
    node = loaded(path)
    slots = [entry for entry in node.pop("defaults", []) if isinstance(entry, dict)]
    filled = {key.partition("@")[0] for entry in slots for key in entry if not key.startswith("override ")}
    beside = {"model", "optimizer"} if "model" in node else set()
    listed = {key for key in node if not key.startswith("_")} - beside | filled
    assert listed == set(parameters_of(get_object(node["_target_"])))


@pytest.mark.parametrize("path", OPTIONS, ids=lambda path: str(path.relative_to(CONF)))
def test_the_class_of_an_option_lies_where_its_file_says(path):
    target = loaded(path)["_target_"]
    assert target.partition(".")[0] in ("omniocc", "omniworld")
    place = target.rsplit(".", 1)[0].replace("omniocc.geometry", "rayiou")  # whose grids have both names
    assert inspect.getmodule(get_object(target)).__name__.startswith(place)


OF_ANOTHER_CLASS = {("sketch", "mono"): "Omni", ("geometry", "occ3d"): "Cuboid", ("hints", "none"): "SketchAndPixels"}
"""Options without a class of their own: another depth option, a grid with a dataset's numbers, all switches off."""


def test_option_module_and_class_share_a_name_with_the_stated_exceptions_alone():
    others = {}
    for path in sorted(CONF.glob("model/*/*.yaml")):
        slot, option = path.parent.name, path.stem
        kind = get_object(loaded(path)["_target_"])
        name = f"no_{slot}" if option == "none" else option
        module = inspect.getmodule(kind).__name__.rsplit(".", 1)[-1]
        if (module, kind.__name__.lower()) != (option, name.replace("_", "")):
            others[slot, option] = kind.__name__
    assert others == OF_ANOTHER_CLASS


@pytest.mark.parametrize("preset", ["tiny", "small", "paper"])
def test_every_preset_composes_and_passes_the_check(preset, composed):
    cfg = composed(f"preset={preset}")
    check_root(cfg)
    assert cfg.logger.mode == "offline"  # nothing is uploaded unless the user asks


def slot_options():
    for folder in sorted((CONF / "model").iterdir()):
        if folder.is_dir():
            yield from (f"model/{folder.name}={path.stem}" for path in sorted(folder.glob("*.yaml")))


@pytest.mark.parametrize("override", list(slot_options()))
def test_every_slot_option_builds_a_model(override, composed):
    beside = {"depth": ["model/sketch=omni"], "backbone": ["model.backbone.weights=null"]}
    cfg = composed(override, *beside.get(override.partition("=")[0].removeprefix("model/"), []))
    check_root(cfg)
    model = build(cfg.model)
    assert model.geometry.shape == build(cfg.model.geometry).shape


def test_mono_sketches_on_monocular_depth_unless_told_otherwise(composed):
    assert composed("model/sketch=omni").depth._target_ == "omniocc.model.depth.OmniMVS"
    assert composed("model/sketch=mono").depth._target_ == "omniocc.model.depth.Mono"
    assert composed("model/sketch=mono", "model/depth=truth").depth._target_ == "omniocc.model.depth.Truth"


def test_all_problems_are_reported_at_once_with_hints(composed):
    cfg = composed(
        "+model.lifter.heds=3", "model.lifter.points=abc", "model.sketch._target_=omniocc.model.sketch.Nope", "seed=x"
    )
    with pytest.raises(ConfigError) as caught:
        check_root(cfg)
    text = str(caught.value)
    assert "4 problems" in text  # the seed counts once, though data and stages take it
    assert "model.lifter.heds: omniocc.model.lifter.Coloring has no such argument; did you mean 'heads'?" in text
    assert "model.lifter.points: 'abc' is not a whole number" in text
    assert "model.sketch._target_: omniocc.model.sketch.Nope cannot be imported" in text
    assert "seed: 'x' is not a whole number" in text


def test_missing_argument_and_broken_interpolation_are_named():
    cfg = OmegaConf.create(
        {
            "part": {
                "_target_": "omniocc.train.AdamW",
                "learning_rate": "${nowhere}",
                "warmup_steps": 3,
                "weight_decay": 0.1,
            }
        }
    )
    with pytest.raises(ConfigError) as caught:
        check(cfg)
    assert any(
        line == "part.learning_rate: refers to nowhere, which does not exist with the chosen options"
        for line in caught.value.problems
    )
    assert any(line == "part.min_lr_ratio: omniocc.train.AdamW needs it" for line in caught.value.problems)


@pytest.mark.parametrize("seed", [-1, 2**32])
@pytest.mark.parametrize(
    "key", ["seed", "stages.depth.seed", "stages.sketch.seed", "data.seed", "data.source.seed", "model.sketch.seed"]
)
def test_a_seed_out_of_range_is_named_once(key, seed, composed):
    with pytest.raises(ConfigError) as caught:
        check_root(composed("model/sketch=random", f"{key}={seed}"))
    assert caught.value.problems == (f"{key}: {seed} is not from 0 to 4294967295",)


@pytest.mark.parametrize("seed", [0, 2**32 - 1])
def test_seeds_at_the_ends_of_the_range_are_taken(seed, composed):
    cfg = composed(f"seed={seed}")
    check_root(cfg)
    seed_everything(cfg.seed, verbose=False)


def test_unknown_root_key_is_refused(composed):
    with pytest.raises(ConfigError, match=r"sed: .*train\.py.*'seed'"):
        check_root(composed("+sed=1"))


@pytest.mark.parametrize(("group", "words"), [("logger", "logger.mode=disabled"), ("trainer", "leave ~trainer out")])
def test_a_group_that_the_command_takes_out_is_named(group, words, composed):
    with pytest.raises(ConfigError, match=rf"{group}: train\.py needs it; .*{words}"):
        check_root(composed(f"~{group}"))


def test_targets_that_are_no_classes_of_allowed_packages_are_refused():
    for name in ("os.system", "omniocc.io.os.system", "torch.load"):
        with pytest.raises(ConfigError, match=f"{name} is (not a class|of the package os)"):
            check(OmegaConf.create({"x": {"_target_": name, "command": "true"}}))


def test_a_value_the_constructor_refuses_is_named():
    cfg = OmegaConf.create(
        {"_target_": "omniocc.geometry.Cylinder", "shape": [4, 4], "radius_m": [0.0, 1.0], "height_m": [0.0, 1.0]}
    )
    with pytest.raises(ConfigError, match="shape"):
        build(cfg)


@pytest.mark.parametrize(
    ("value", "hint", "expected"),
    [
        (1, int, True),
        (True, int, False),
        (1, float, True),
        ("1", float, False),
        (10**400, float, False),
        ([1, 2], tuple[int, int], True),
        ([1, 2, 3], tuple[int, int], False),
        ([1, "a"], list[int], False),
        (None, int | None, True),
        ("a", Literal["a", "b"], True),
        ("c", Literal["a", "b"], False),
        ([1.0, 2], tuple[float, ...], True),
        (math.nan, float, False),
        (-math.inf, float, False),
        (0, Rate, False),
        (100, Rate, True),
        (1, Kept, False),
        (True, Count, False),
        ({"a": -1}, dict[str, Weight], False),
        ({"a": 1}, Mapping[str, Weight], True),
        ("a", Mapping[str, Weight], False),
    ],
)
def test_fits(value, hint, expected):
    assert fits(value, hint) is expected


OF_A_PRESET = re.compile(r"\$\{oc\.select:preset\.([\w.]+),")
"""Beginning of a number in an option's file that presets may replace, with its key below `preset`."""


@pytest.mark.parametrize(
    "path", sorted(CONF.glob("model/*/*.yaml")), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_presets_replace_a_number_of_an_option_by_slot_option_and_key(path):
    for key, value in leaves(OmegaConf.to_container(OmegaConf.load(path))).items():
        if match := OF_A_PRESET.match(str(value)):
            assert match[1] == f"{path.parent.name}.{path.stem}.{key}"


def test_a_preset_holds_what_options_share_and_what_differs_from_their_files():
    own = {}  # the numbers in the options' files; the learning rate stands in several
    for path in CONF.rglob("*.yaml"):
        for value in leaves(OmegaConf.to_container(OmegaConf.load(path))).values():
            if match := OF_A_PRESET.match(str(value)):
                number = OmegaConf.create({"number": value})
                own.setdefault(match[1], []).append(OmegaConf.to_container(number, resolve=True)["number"])
    presets = {path.stem: leaves(OmegaConf.to_container(OmegaConf.load(path))) for path in CONF.glob("preset/*.yaml")}
    assert sorted(presets) == ["paper", "small", "smoke", "tiny"]
    shared = presets["tiny"].keys()
    assert not shared & own.keys()
    for name, preset in presets.items():
        assert shared <= preset.keys(), name
        assert preset.keys() <= shared | own.keys(), f"{name}: nothing reads these"
        assert [key for key in preset.keys() & own.keys() if own[key] == [preset[key]]] == [], f"{name}: no difference"


def leaves(tree: dict, prefix: str = "") -> dict:
    """Return the values of a tree by dotted key; the sizes of a backbone of another library are one value."""
    found = {}
    for key, value in tree.items():
        nested = isinstance(value, dict) and value and key != "sizes"
        found |= leaves(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return found


def test_numbers_of_a_preset_are_part_of_a_hash_where_a_chosen_option_has_them(composed):
    def hashes(*overrides):
        cfg = composed(*overrides)
        return run_hash(plain(cfg), "data"), *stage_keys(cfg, "data")[:3]

    usual = hashes()
    assert hashes("+preset.refiner.conv.channels=[8,8,8]", "preset.name=other") == usual
    run, *stages = hashes("+preset.refiner.unet.channels=[8,8,8]")
    assert run != usual[0]
    assert tuple(stages) == usual[1:]
    assert hashes("model.refiner.channels=[8,8,8]") == (run, *stages)
    run, depth, *others = hashes("+preset.sketch.omni.channels=[8,8,8]")
    assert depth == usual[1]
    assert not {run, *others} & {*usual}
    assert not {*hashes("preset.depth.spheres=16")} & {*usual}


@pytest.mark.parametrize("preset", ["smoke", "tiny", "small", "paper"])
def test_the_plain_command_is_the_papers_model(preset):
    plain_command, row = (
        compose_plain(CONF, "train", [f"preset={preset}", *more]) for more in ((), ("+ablation=ours",))
    )
    assert run_hash(plain_command, "data") == run_hash(row, "data")
    assert (
        plain_command["optimizer"]["learning_rate"]
        == {"smoke": 3e-3, "tiny": 0.01, "small": 1e-3, "paper": 2e-4}[preset]
    )


@pytest.mark.parametrize(
    ("model", "rate"),
    [
        *((model, 3e-3) for model in ("bevdet", "bevformer", "voxformer", "flashocc", "fosocc", "extended")),
        *((model, 0.01) for model in ("default", "oneocc", "adaptiveocc")),
    ],
)
def test_every_model_has_the_rate_that_was_chosen_for_it(model, rate):
    for optimizer in ("muon", "adamw"):
        config = compose_plain(CONF, "train", ["preset=tiny", f"model={model}", f"optimizer={optimizer}"])
        assert config["optimizer"]["learning_rate"] == rate


class Narrow(Cylinder):
    """Inherits its constructor."""


def test_values_of_an_inherited_constructor_are_checked(monkeypatch):
    monkeypatch.setattr("omniocc.geometry.Narrow", Narrow, raising=False)
    Narrow.__module__ = "omniocc.geometry"
    arguments = {"shape": "wide", "radius_m": [0.0, 1.0], "height_m": [0.0, 1.0]}
    with pytest.raises(ConfigError, match="shape: 'wide' is not"):
        check(OmegaConf.create({"x": {"_target_": "omniocc.geometry.Narrow", **arguments}}))


def test_arguments_of_the_trainer_that_would_do_nothing_are_refused(composed):
    with pytest.raises(ConfigError, match=r"trainer\.callbacks: .*\n.*trainer\.fast_dev_run: "):
        check_root(composed("+trainer.fast_dev_run=true", "+trainer.callbacks=[]"))
    check_root(composed("+trainer.detect_anomaly=true"))


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("optimizer.learning_rate=nan", "optimizer.learning_rate: nan is not a number above 0 and at most 100"),
        ("optimizer.learning_rate=0", "optimizer.learning_rate: 0 is not a number above 0"),
        ("optimizer.weight_decay=-0.1", "optimizer.weight_decay: -0.1 is not a number from 0 to 1,000,000"),
        ("optimizer.warmup_steps=-1", "optimizer.warmup_steps: -1 is not a whole number from 0"),
        ("optimizer.momentum=1", "optimizer.momentum: 1 is not a number from 0 on and below 1"),
        ("stages.depth.optimizer.min_lr_ratio=2", "stages.depth.optimizer.min_lr_ratio: 2 is not a number from 0 to 1"),
        ("stages.depth.batch_size=0", "stages.depth.batch_size: 0 is not a whole number from 1"),
        ("stages.sketch.max_steps=-2", "stages.sketch.max_steps: -2 is not a whole number from -1"),
        ("stages.depth.validate_every_n_epochs=0", "validate_every_n_epochs: 0 is not a whole number from 1 "),
        ("checkpoint_every_n_steps=0", "checkpoint_every_n_steps: 0 is not a whole number from 1 to 1,000,000,000"),
        ("test_images=-1", "test_images: -1 is not a whole number from 0"),
        ("ema_decay=2", "ema_decay: 2 is not a number from 0 on and below 1 or null"),
        ("+lr_multipliers.backbone=-1", "lr_multipliers: {'backbone': -1} is not a mapping, each a number from 0"),
        ("trainer.gradient_clip_val=-1", "trainer.gradient_clip_val: -1 is not a number from 0 to 1,000,000 or null"),
        ("trainer.gradient_clip_val=.inf", "trainer.gradient_clip_val"),
        ("trainer.limit_val_batches=0", "trainer.limit_val_batches: 0 is not a whole number from 1"),
        ("trainer.limit_test_batches=0.0", "trainer.limit_test_batches: 0.0 is not"),
        ("trainer.precision=bf16-true", "trainer.precision: 'bf16-true' is not one of '32-true', 'bf16-mixed'"),
        ("trainer.precision=64-true", "trainer.precision: '64-true' is not one of"),
        ("trainer.num_nodes=0", "trainer.num_nodes: 0 is not a whole number from 1 to 1,000"),
        ("data.window=0", "data.window: 0 is not a whole number from 1 to 1,000"),
        ("data.num_workers=1000000", "data.num_workers: 1000000 is not a whole number from 0 to 1,000"),
        ("data.source.frame_interval_s=0", "data.source.frame_interval_s: 0 is not a number above 0 and at most 3,600"),
        ("data.source.erp_size=[0,8]", "data.source.erp_size: [0, 8] is not a list, each a whole number from 1"),
        ("loss.weights.ce=-1", "loss.weights: "),
        ("loss.weights.ce=nan", "loss.weights: "),
        ("loss.voxel.ce.constant=inf", "loss.voxel.ce.constant: inf is not a number"),
        ("augment.hue_deg=-1", "augment.hue_deg: -1 is not a number from 0 to 180"),
        ("depth.channels=[64,0,64]", "depth.channels: [64, 0, 64] is not a list, each a whole number from 1 to 65,536"),
        ("depth.groups=0", "depth.groups: 0 is not a whole number from 1"),
        ("depth.loss.sky_weight=-1", "depth.loss.sky_weight: -1 is not a number from 0"),
        ("model.lifter.layers=0", "model.lifter.layers: 0 is not a whole number from 1"),
        ("model.sketch.samples=[0,1,1]", "model.sketch.samples: "),
        ("model.sketch.dilation_m=[0,.inf,0]", "model.sketch.dilation_m: "),
        ("model.backbone.channels=1000000000000", "model.backbone.channels: 1000000000000 is not a whole number"),
    ],
)
def test_a_number_without_sense_is_named_with_its_range(override, problem, composed):
    with pytest.raises(ConfigError) as caught:
        check_root(composed(override))
    assert any(problem in line for line in caught.value.problems)


@pytest.mark.parametrize(
    "override",
    [
        *("ema_decay=0", "ema_decay=null", "test_images=0", "trainer.gradient_clip_val=0", "trainer.precision=16"),
        *("trainer.limit_val_batches=1", "trainer.limit_val_batches=0.5", "trainer.precision=bf16-mixed"),
        *(
            "stages.occupancy.max_steps=-1",
            "stages.depth.max_epochs=null",
            "depth.context_channels=0",
            "depth.blocks=0",
        ),
        *("optimizer.warmup_steps=0", "optimizer.weight_decay=0", "loss.weights.ce=0", "optimizer.momentum=0"),
    ],
)
def test_numbers_at_the_ends_of_their_range_are_taken(override, composed):
    check_root(composed(override))


@pytest.mark.parametrize("model", ["default", "adaptiveocc", "fosocc"])
def test_a_tree_can_be_resolved_in_place(model, composed):
    """As `python src/train.py --cfg job --resolve` does."""
    cfg = composed(f"model={model}", "preset=tiny")
    OmegaConf.resolve(cfg)
    assert list(cfg.model.refiner.channels)


@pytest.mark.parametrize("override", ["model.sketch=mono", "model.refiner=none", "model.geometry=cuboid"])
def test_an_option_behind_a_point_is_told(composed, override):
    with pytest.raises(
        ConfigError, match=re.escape(f"{override}: options are chosen with a slash, model/{override[6:]}")
    ):
        check_root(composed(override))


@pytest.mark.parametrize(
    "text", ["my_rig.yaml", "/a/b c.yaml", "../x/y.json", "null", "NaN", "1e5", "a,b", "it's", "./1"]
)
def test_any_text_is_the_value_of_an_override(text):
    value = OverridesParser.create().parse_override(f"key={quoted(text)}").value()
    assert getattr(value, "text", value) == text
