"""Counts of rays of every test scene in a file of the run, and the scores of groups of scenes that follow from them."""

import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from omniocc.bounds import fits
from omniocc.errors import FAULTS, UserError, first_line, in_line, repr_of
from omniocc.io import atomic_write, parse_json, read_short_text
from rayiou.bands import band_suffixes
from rayiou.ray_counts import RayCounts, ray_scores

SCENES = "scenes.json"
RAYS, LIDAR, MOVING = "rays", "lidar", "moving"
"""Kinds of rays: against true voxels, LiDAR rays, and those of them that hit what moves."""
Lines = list[list[int]]
"""Numbers of rays by class: true, predicted, and correct at each threshold."""
Counted = dict[str, Lines]
"""Counts of a scene by kind of rays."""
HINTS = {"classes": list[str], "thresholds_m": list[float], "scenes": dict[str, dict[str, Any]]}
"""Types of what the file holds."""
MOST_RAYS = 2**53
"""Rays that no scene has: a sum of more is not exact."""


def save_scenes(
    folder: Path,
    counted: Mapping[str, Counted],
    conditions: Mapping[str, Mapping[str, str]],
    classes: Sequence[str],
    thresholds_m: Sequence[float],
) -> None:
    """Write the counts of every scene, a line each, with its conditions (weather, place).

    Args:
        folder: of the run.
        counted: counts by scene.
        conditions: by scene; a scene may have none.
        classes: names by id, free included.
        thresholds_m: distances within which hits are correct.

    Raises:
        DataError: naming the file that cannot be written.
    """
    head = (
        f'{{"classes": {json.dumps(list(classes))},\n "thresholds_m": {json.dumps(list(thresholds_m))},\n "scenes": {{'
    )
    lines = [f"  {json.dumps(name)}: {_line(conditions.get(name, {}), scene)}" for name, scene in counted.items()]
    atomic_write(folder / SCENES, head + "\n" + ",\n".join(lines) + "\n}}\n")


def _line(conditions: Mapping[str, str], scene: Counted) -> str:
    return json.dumps({"conditions": dict(conditions), **scene}, separators=(",", ":"))


def scene_figures(folder: Path) -> dict[str, float]:
    """Return the scores of groups of scenes by key; none for runs that kept no counts.

    `test/<condition>/<value>/rayiou` and `.../lidar/rayiou` are the RayIoU of the scenes of one weather or kind of
    place, with counts summed over them. For classes that move, `test/moving/recall/<class>` and
    `test/standing/recall/<class>` are the correct fraction of the LiDAR rays that hit what moves, and what stands (mean
    over thresholds); `test/false_alarms/<class>` is the number of rays on which the class is predicted and not found
    within the largest threshold, for each ray that hits it. Without a class: their mean.

    Raises:
        UserError: naming the file, when it is damaged.
    """
    with _naming(folder):
        content = _read(folder)
        return {} if content is None else _by_conditions(content) | _of_moving(content)


def without_each_scene(folder: Path, kind: str) -> dict[str, float]:
    """Return by scene the RayIoU of all other scenes together, by one kind of rays; none for runs without such counts.

    Raises:
        UserError: naming the file, when it is damaged.
    """
    with _naming(folder):
        content = _read(folder)
        return {} if content is None else _without_each(content, kind)


def _read(folder: Path) -> Any:
    path = folder / SCENES
    if not os.path.lexists(path):
        return None
    content = parse_json(read_short_text(path))
    if wrong := [key for key, hint in HINTS.items() if not fits(content[key], hint)]:
        raise ValueError(f"{wrong[0]} is {repr_of(content[wrong[0]])}")
    shape = (2 + len(content["thresholds_m"]), len(content["classes"]))
    for name, scene in content["scenes"].items():
        if not fits(scene["conditions"], dict[str, str]):
            raise ValueError(f"the conditions of {in_line(name)} are {repr_of(scene['conditions'])}")
        if wrong := [kind for kind in (RAYS, LIDAR, MOVING) if kind in scene and not _are_counts(scene[kind], shape)]:
            lines = f"{shape[0]} lines of {shape[1]} numbers"
            raise ValueError(f"the counts of {in_line(name)}, {wrong[0]}, are not {lines}")
    return content


def _are_counts(lines: Any, shape: tuple[int, int]) -> bool:
    if not isinstance(lines, list) or not all(isinstance(line, list) for line in lines):
        return False
    numbers = [number for line in lines for number in line]
    known = {*map(type, numbers)} == {int} and min(numbers) >= 0 and max(numbers) < MOST_RAYS
    return known and list(map(len, lines)) == [shape[1]] * shape[0]


@contextmanager
def _naming(folder: Path) -> Iterator[None]:
    """Raise UserError naming the file of a folder if what is done with its content fails."""
    try:
        yield
    except FAULTS as error:
        reason = first_line(error)
        path = folder / SCENES
        raise UserError(f"{path} is damaged ({reason}); without it the run has no scores by scene") from error


def _without_each(content: Mapping[str, Any], kind: str) -> dict[str, float]:
    counted = {name: scene for name, scene in content["scenes"].items() if kind in scene}
    every = summed(counted.values(), kind)
    if every is None or len(counted) < 2:
        return {}
    left = [every - torch.tensor(scene[kind]) for scene in counted.values()]
    return dict(zip(counted, _rayiou_of_each(left, content), strict=True))


def _by_conditions(content: Mapping[str, Any]) -> dict[str, float]:
    scenes = content["scenes"].values()
    groups = dict.fromkeys(entry for scene in scenes for entry in sorted(scene["conditions"].items()))
    counts = {}
    for condition, value in groups:
        members = [scene for scene in scenes if scene["conditions"].get(condition) == value]
        for kind, prefix in ((RAYS, ""), (LIDAR, "lidar/")):
            if (lines := summed(members, kind)) is not None:
                counts[f"test/{condition}/{value}/{prefix}rayiou"] = lines
    return dict(zip(counts, _rayiou_of_each([*counts.values()], content), strict=True))


def _of_moving(content: Mapping[str, Any]) -> dict[str, float]:
    told = [scene for scene in content["scenes"].values() if MOVING in scene]
    moving, every = summed(told, MOVING), summed(told, LIDAR)
    if moving is None or every is None:
        return {}
    occur = (moving[0] > 0).nonzero().flatten().tolist()
    classes = {k: content["classes"][k] for k in occur if k}
    recalls = _recalls("moving", moving, classes) | _recalls("standing", every - moving, classes)
    return recalls | _false_alarms(every, classes)


def _recalls(name: str, lines: torch.Tensor, classes: Mapping[int, str]) -> dict[str, float]:
    return _with_mean(
        f"test/{name}/recall",
        {title: float(lines[2:, k].double().mean() / lines[0, k]) for k, title in classes.items() if lines[0, k] > 0},
    )


def _false_alarms(lines: torch.Tensor, classes: Mapping[int, str]) -> dict[str, float]:
    return _with_mean(
        "test/false_alarms",
        {title: float((lines[1, k] - lines[2:, k].max()) / lines[0, k]) for k, title in classes.items()},
    )


def _with_mean(key: str, by_class: Mapping[str, float]) -> dict[str, float]:
    if not by_class:
        return {}
    return {key: sum(by_class.values()) / len(by_class)} | {f"{key}/{name}": part for name, part in by_class.items()}


def summed(scenes: Collection[Mapping[str, Any]], kind: str) -> torch.Tensor | None:
    """Return the counts of one kind of rays over scenes, (2 + thresholds, classes); None if no scene has them."""
    found = [torch.tensor(scene[kind]) for scene in scenes if kind in scene]
    return torch.stack(found).sum(0) if found else None


def _rayiou_of_each(groups: Sequence[torch.Tensor], content: Mapping[str, Any]) -> list[float]:
    """Return the RayIoU of each group of scenes, from its counts, (2 + thresholds, classes)."""
    if not groups:
        return []
    rows = torch.stack([*groups, torch.zeros_like(groups[0])])
    edges = range(len(rows))  # a group stands where a range band does: one call scores all, which is ten times as fast
    counts = RayCounts(rows[:, 0], rows[:, 1], rows[:, 2:], rows.new_zeros(len(rows), rows.shape[1] - 2))
    scores = ray_scores(counts, dict(enumerate(content["classes"][1:], 1)), content["thresholds_m"], edges)
    return [float(scores[f"rayiou{suffix}"]) for suffix in band_suffixes(edges)]
