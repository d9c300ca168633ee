"""The virtual world as a dataset: which scenes there are, where they lie, and how they come to be."""

import ast
import functools
import hashlib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

from omniocc.camera import Rig
from omniocc.classes import CLASSES
from omniocc.data.codec import encode_frame
from omniocc.data.errors import DataError
from omniocc.data.pool import Report, Stopped, make_scenes, usable_cores
from omniocc.data.progress import FrameProgress
from omniocc.data.reader import SceneReader
from omniocc.data.shard import SCHEMA, SceneWriter, digest
from omniocc.world import THEMES, Frame, Scene

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")
SEEDS_PER_SPLIT = 1_000_000
RECORDERS = ("numpy", "opencv-python-headless", "zstandard", "embreex")


class ScenePlan(NamedTuple):
    """One scene to be: its name, the map it lies in, and the seed of everything random in it."""

    name: str
    split: Split
    theme: str
    seed: int


@runtime_checkable
class Recordable(Protocol):
    """What a scene offers: `omniocc.world.Scene` and whatever else makes frames."""

    def frame(self, index: int) -> Frame:
        """The frame with this number; depends on nothing but the scene and the number."""
        ...


@functools.cache
def code_fingerprint(folder: Path) -> str:
    """Hash of what the modules of a folder do: comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if (
                isinstance(body, list)
                and body
                and isinstance(body[0], ast.Expr)
                and isinstance(body[0].value, ast.Constant)
            ):
                body[0].value.value = ""
        digest.update(f"{path.name}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()[:16]


class VirtualWorld:
    """A dataset rendered on first use under `root/virtual-<fingerprint of one scene's recipe>`.

    Scenes of the three splits have disjoint seeds: other streets. Adding scenes keeps those that exist; every other
    change of what a frame holds leads to another folder, so that settings never mix.

    Args:
        root: folder of all datasets.
        rig: built-in rig by name, or a rig file.
        image_size: width and height of every camera image, px.
        themes: kinds of places; scenes go through them in turn.
        train_scenes: number of scenes to train on.
        val_scenes: number of scenes to validate on.
        test_scenes: number of scenes to test on.
        frames_per_scene: recorded frames of each scene.
        frame_interval_s: time between recorded frames.
        supersample: camera rays per pixel along each side.
        erp_size: width and height of the panorama of ranges, px.
        erp_top_deg: elevation of the panorama's upper edge.
        erp_bottom_deg: elevation of its lower edge.
        seed: another number gives other streets in all splits.
        shard_limit_mib: size at which a new tar shard begins, MiB.
        workers: processes that render; 0 renders in this process, None takes all usable cores.
    """

    def __init__(
        self,
        root: str,
        rig: str,
        image_size: Sequence[int],
        themes: Sequence[str],
        train_scenes: int,
        val_scenes: int,
        test_scenes: int,
        frames_per_scene: int,
        frame_interval_s: float,
        supersample: int,
        erp_size: Sequence[int],
        erp_top_deg: float,
        erp_bottom_deg: float,
        seed: int = 0,
        shard_limit_mib: int = 256,
        workers: int | None = None,
    ):
        self.root = Path(root)
        self.rig = Rig.load(rig).resized(*image_size)
        self.themes = tuple(themes)
        self.num_scenes = {"train": train_scenes, "val": val_scenes, "test": test_scenes}
        self.frames_per_scene = _at_least("frames_per_scene", frames_per_scene, 1)
        self.frame_interval_s = float(frame_interval_s)
        self.supersample = _at_least("supersample", supersample, 1)
        self.erp_size = tuple(erp_size)
        self.erp_top_deg = float(erp_top_deg)
        self.erp_bottom_deg = float(erp_bottom_deg)
        self.seed = _at_least("seed", seed, 0)
        self.shard_limit_bytes = _at_least("shard_limit_mib", shard_limit_mib, 1) * 2**20
        self.workers = usable_cores() if workers is None else _at_least("workers", workers, 0)
        unknown = [theme for theme in self.themes if theme not in THEMES]
        if unknown or not self.themes:
            raise ValueError(f"themes are {list(self.themes)}: choose one or more of {', '.join(THEMES)}")
        for split, count in self.num_scenes.items():
            if not 0 <= count < SEEDS_PER_SPLIT:
                raise ValueError(f"{split}_scenes must be from 0 to {SEEDS_PER_SPLIT - 1}, got {count}")

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """Everything, beside theme and seed, that decides what the frames of a scene hold."""
        return {
            "schema": SCHEMA,
            "world": code_fingerprint(Path(inspect.getfile(Scene)).parent),
            "rig": self.rig.fingerprint,
            "frames_per_scene": self.frames_per_scene,
            "frame_interval_s": self.frame_interval_s,
            "supersample": self.supersample,
            "erp_size": list(self.erp_size),
            "erp_top_deg": self.erp_top_deg,
            "erp_bottom_deg": self.erp_bottom_deg,
            "shard_limit_bytes": self.shard_limit_bytes,
        }

    @cached_property
    def plans(self) -> tuple[ScenePlan, ...]:
        """All scenes, in the order of splits and numbers."""
        return tuple(self._plan(split, number) for split in SPLITS for number in range(self.num_scenes[split]))

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the recipe and of the list of scenes: equal for equal data."""
        return digest({"recipe": self.recipe, "plans": [list(plan) for plan in self.plans]})

    @property
    def folder(self) -> Path:
        """Where the scenes lie."""
        return self.root / f"virtual-{digest(self.recipe)[:12]}"

    def scene(self, plan: ScenePlan) -> Recordable:
        """Build the world of one scene."""
        return Scene(
            theme=plan.theme,
            seed=plan.seed,
            rig=self.rig,
            frame_interval_s=self.frame_interval_s,
            supersample=self.supersample,
            erp_size=self.erp_size,
            erp_top_deg=self.erp_top_deg,
            erp_bottom_deg=self.erp_bottom_deg,
        )

    def missing(self) -> list[ScenePlan]:
        """Scenes that are not complete on disk."""
        return [plan for plan in self.plans if not (self.folder / plan.name).exists()]

    def prepare(self) -> None:
        """Render what is missing; safe to call from several processes at once and to repeat after a kill.

        Raises:
            DataError: when the disk refuses.
            RuntimeError: naming scene and frame, when rendering fails.
        """
        missing = self.missing()
        if not missing:
            return
        work = SceneJob(
            self.scene, tuple(missing), self.recipe, self.rig, self.frames_per_scene, self.shard_limit_bytes
        )
        with FrameProgress(f"rendering {self.folder}", len(missing) * self.frames_per_scene) as progress:
            make_scenes(work, [self.folder / plan.name for plan in missing], self.workers, progress)

    def readers(self, split: Split) -> list[SceneReader]:
        """The scenes of a split, in order.

        Raises:
            DataError: when a scene is not there.
        """
        names = [plan.name for plan in self.plans if plan.split == split]
        for name in names:
            if not (self.folder / name).is_dir():
                raise DataError(
                    f"{self.folder / name} is missing: call prepare(), or run `python src/render.py`, first"
                )
        return [SceneReader(self.folder / name) for name in names]

    def _plan(self, split: Split, number: int) -> ScenePlan:
        theme = self.themes[number % len(self.themes)]
        # one street never stands in two splits, whatever the numbers of scenes
        seed = (self.seed * len(SPLITS) + SPLITS.index(split)) * SEEDS_PER_SPLIT + number
        name = f"{split}-{number:03d}-{theme}" if self.seed == 0 else f"{split}-{number:03d}-{theme}-seed{self.seed}"
        return ScenePlan(name, split, theme, seed)


@dataclass(frozen=True)
class SceneJob:
    """Renders one scene folder after another; can be sent to other processes.

    Attributes:
        build: world of a planned scene.
        plans: the scenes it may be asked for.
        recipe: is written beside the frames.
        rig: likewise.
        frames: number of frames of each scene.
        shard_limit_bytes: see `SceneWriter`.
    """

    build: Callable[[ScenePlan], Recordable]
    plans: tuple[ScenePlan, ...]
    recipe: dict[str, Any]
    rig: Rig
    frames: int
    shard_limit_bytes: int

    def __call__(self, folder: Path, report: Report) -> None:
        """Render the frames of `folder` that are missing, then seal it.

        Raises:
            RuntimeError: naming scene and frame, when the world fails.
        """
        writer = SceneWriter(folder, self.shard_limit_bytes)
        try:
            if writer.finished:
                report(self.frames)
            else:
                self._record(writer, next(plan for plan in self.plans if plan.name == folder.name), report)
        finally:
            writer.close()

    def _record(self, writer: SceneWriter, plan: ScenePlan, report: Report) -> None:
        report(writer.num_frames)
        index = writer.num_frames
        try:
            scene = self.build(plan) if index < self.frames else None
            for index in range(writer.num_frames, self.frames):
                assert scene is not None
                frame = scene.frame(index)
                entry = {"time_s": float(frame.time_s), "world_from_ego": frame.world_from_ego.tolist()}
                writer.append(encode_frame(frame), entry)
                report(1)
        except (DataError, Stopped):
            raise
        except Exception as error:  # whatever went wrong: say where
            raise RuntimeError(f"scene {plan.name}, frame {index}: {type(error).__name__}: {error}") from error
        writer.attach("rig.yaml", self.rig.save)
        facts = {"split": plan.split, "theme": plan.theme, "seed": plan.seed, "recipe": self.recipe}
        writer.finish(facts | {"classes": {str(row.id): row.name for row in CLASSES}, "software": _software()})


@functools.cache
def _software() -> dict[str, str]:
    return {name: version(name) for name in RECORDERS}


def _at_least(name: str, value: int, least: int) -> int:
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    return value
