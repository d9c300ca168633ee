"""The stages of a configuration, and hashes of everything that decides their results."""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

from omegaconf import DictConfig

from omniocc.config import plain, target_of
from omniocc.errors import UserError
from omniocc.model.protocols import LearnedSketch
from omniocc.runs.folder import OF_MACHINES, short_hash, with_digests
from omniocc.runs.slots import depth_learns, foreign_code, sketch_learns

STAGES = ("depth", "sketch", "occupancy")
VERSIONS = {"depth": 4, "sketch": 1, "candidates": 1}
"""Versions in the hashes: increase one when the same configuration gives other results."""

OVERRULED = ("val_check_interval", "strategy", *OF_MACHINES)
"""Trainer options that do not change the results of depth and sketch."""


def wanted_stages(cfg: DictConfig) -> tuple[str, ...]:
    """Return the stages up to the configured one (`stage=...`), in order.

    Raises:
        UserError: for an unknown stage, or one that the model does not have.
    """
    stage = cfg.stage or "occupancy"
    if stage not in STAGES:
        raise UserError(f"stage={stage}: choose one of {', '.join(STAGES)}; leave it out to run all missing ones")
    present = STAGES if sketch_learns(cfg) else STAGES[-1:]
    if stage not in present:
        raise UserError(f"stage={stage}: this model/sketch has no such stage; choose model/sketch=omni or mono")
    return present[: present.index(stage) + 1]


class Keys(NamedTuple):
    """Hashes of everything that decides the results of a stage.

    Attributes:
        depth: of the depth stage.
        sketch: of the weights of the sketch stage.
        candidates: of the candidates that are chosen with them.
        ranges_of_all: of the ranges of a depth option that is used as it is; None where it is trained.
        sketched_of_all: of what a sketch finds in these ranges that is used as it is; None where it is trained.
        candidates_of_all: of the candidates among that.
    """

    depth: str
    sketch: str
    candidates: str
    ranges_of_all: str | None
    sketched_of_all: str | None
    candidates_of_all: str | None


def stage_keys(cfg: DictConfig, data_fingerprint: str) -> Keys:
    """Return the hashes for a configuration with a learned sketch.

    Networks that are used as they are give the same for a scene in any data, so that their hashes, those `of_all`, do
    not depend on the data.
    """
    config = plain(cfg)
    trainer = _without(config["trainer"], OVERRULED)
    together = config["data"].get("samples_per_scene", 1)  # decides the order of the samples
    trainer |= {} if together == 1 else {"samples_per_scene": together}
    stages = with_digests(config["stages"], STAGES[:2])
    sketch = config["model"]["sketch"]
    selection = cast(type[LearnedSketch], target_of(sketch)).SELECTION
    appearance = [config["appearance"]] if config.get("appearance") else []
    bands = config["data"].get("range_edges_m")  # of the scores of both stages
    known = [data_fingerprint, *appearance, *([] if bands is None else [["bands", bands]])]
    depth_key = short_hash(
        [
            *(VERSIONS["depth"], config["depth"], stages["depth"], trainer, *known),
            *foreign_code([config["depth"], stages["depth"], *appearance]),
        ]
    )
    network = _without(sketch, selection)
    labels = config["data"]["ignore"]
    loss, rays, terms = config["loss"], [], {}
    if loss.get("rays"):
        terms = loss["lidar"]
        voxels = any(loss.get(part) for part in ("voxel", "run", "coarse"))  # labels of these train the sketch, too
        rays = [sorted(loss["rays"]["frames"]), terms, {name: loss["weights"][name] for name in terms}, voxels]
    code = foreign_code([network, stages["sketch"], terms])
    recipe = [stages["sketch"], trainer, labels, *rays]
    sketch_key = short_hash([VERSIONS["sketch"], depth_key, network, *recipe, *code])
    arguments = {name: sketch[name] for name in selection}
    candidates_key = short_hash([VERSIONS["candidates"], sketch_key, arguments])
    ranges = sketched = candidates = None
    if _used_as_it_is(stages["depth"]) or not depth_learns(config):
        weights = stages["depth"].get("weights")
        ranges = short_hash([VERSIONS["depth"], config["depth"], weights, *foreign_code(config["depth"])])
    if ranges and _used_as_it_is(stages["sketch"]):
        sketched = short_hash(
            [VERSIONS["sketch"], ranges, network, stages["sketch"]["weights"], *foreign_code(network)]
        )
        candidates = short_hash([VERSIONS["candidates"], sketched, arguments])
    return Keys(depth_key, sketch_key, candidates_key, ranges, sketched, candidates)


def _used_as_it_is(recipe: Mapping[str, Any]) -> bool:
    return recipe["max_steps"] == 0 and recipe.get("weights") is not None


def _without(arguments: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in arguments.items() if key not in names}
