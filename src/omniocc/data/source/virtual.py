"""The virtual world as a source: its scenes, their folder, and their rendering."""

import inspect
from collections.abc import Sequence
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, get_args

from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.recording.job import Recordable, ScenePlan, code_fingerprint, record_scene
from omniocc.data.recording.pool import make_scenes, usable_cores
from omniocc.data.source import SPLITS, SourceSpec, Split, Unknown
from omniocc.data.store.files import holds, is_url
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META, SCHEMA, digest
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.geometry.cylinder import PAPER_RANGE_EDGES_M
from omniocc.geometry.directions import sparseocc_directions
from omniocc.progress import Progress
from omniocc.world import THEMES, Scene
from omniocc.world.assets.vehicle import EGO_ROAD_M
from omniocc.world.render.weather import Weather
from omniocc.world.scene import LabelMode
from omniocc.world.sensors.recorder import Capture

SEEDS_PER_SPLIT = 1_000_000
SETTINGS = (
    "frame_interval_s", "supersample", "erp_size", "erp_top_deg", "erp_bottom_deg", "weather", "label_mode", "lidars",
    "capture",
)  # fmt: skip
"""Arguments of `Scene` that are equal for all scenes."""


class VirtualWorld:
    """A source (`SceneSource`) rendered on first use under `root/virtual-<hash of recipe>`.

    The three splits have disjoint seeds, and therefore different streets. Adding scenes keeps those that exist; every
    change in the content of a frame leads to another folder, so that settings never mix.

    Args:
        root: folder of all datasets, or a URL (memory://, http://, s3:// ...) of data rendered elsewhere.
        rig: built-in rig by name, or a rig file.
        image_size: width and height of every camera image, px.
        themes: kinds of places; the scenes of a split take them in turn, those of the test split from the middle on.
        frames_per_scene: recorded frames of each scene.
        frame_interval_s: time between recorded frames.
        supersample: camera rays per pixel along each side.
        erp_size: width and height of the panorama of ranges, px.
        erp_top_deg: elevation of the panorama's upper edge.
        erp_bottom_deg: elevation of its lower edge.
        weather: of all scenes; None draws one for each by its seed.
        label_mode: `lidar20`, points of virtual LiDARs as in the paper, or `geometry`, all surfaces, seen or not.
        lidars: number of virtual LiDARs of `lidar20`.
        capture: `direct`, a ray through every pixel, or `cubemap`, sampled from flat images as in the paper.
        seed: of the streets in all splits.
        shard_limit_mib: size at which a new tar shard begins, MiB.
        workers: processes that render; 0 renders in this process, None takes all usable cores.
        cache: folder for derived data (voxels); None puts it beside the scenes. A URL as root needs one.
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
        weather: Weather | None = None,
        label_mode: LabelMode = "lidar20",
        lidars: int = 20,
        capture: Capture = "direct",
        seed: int = 0,
        shard_limit_mib: int = 256,
        workers: int | None = None,
        cache: str | None = None,
    ):
        if is_url(root) and cache is None:
            raise ValueError(f"root is a URL ({root}): set cache to a local folder, where voxels are kept")
        self.root = root
        self.cache = cache
        self.rig = Rig.load(rig).resized(*image_size)
        self.themes = tuple(themes)
        self.num_scenes = {"train": train_scenes, "val": val_scenes, "test": test_scenes}
        self.frames_per_scene = _at_least("frames_per_scene", frames_per_scene, 1)
        self.frame_interval_s = float(frame_interval_s)
        self.supersample = _at_least("supersample", supersample, 1)
        self.erp_size = tuple(erp_size)
        self.erp_top_deg = float(erp_top_deg)
        self.erp_bottom_deg = float(erp_bottom_deg)
        self.weather: Weather | None = None if weather is None else _one_of("weather", weather, get_args(Weather))
        self.label_mode: LabelMode = _one_of("label_mode", label_mode, get_args(LabelMode))
        self.lidars = _at_least("lidars", lidars, 1)
        self.capture: Capture = _one_of("capture", capture, get_args(Capture))
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
        """Return everything that decides the content of a scene's frames, except theme and seed."""
        return {
            "schema": SCHEMA,
            "world": code_fingerprint(Path(inspect.getfile(Scene)).parent),
            "rig": self.rig.fingerprint,
            "frames_per_scene": self.frames_per_scene,
            **self._settings,
            "erp_size": list(self.erp_size),
            "shard_limit_bytes": self.shard_limit_bytes,
        }

    @cached_property
    def plans(self) -> tuple[ScenePlan, ...]:
        """Return all scenes, in the order of splits and numbers."""
        return tuple(self._plan(split, number) for split in SPLITS for number in range(self.num_scenes[split]))

    @property
    def fingerprint(self) -> str:
        """Return a hash of the recipe and of the list of scenes: equal for equal data."""
        return digest({"recipe": self.recipe, "plans": [list(plan) for plan in self.plans]})

    @property
    def spec(self) -> SourceSpec:
        """Return the classes, bands and rays of the virtual world."""
        return world_spec(self.frame_interval_s)

    @property
    def name(self) -> str:
        """Return the name of the folder that holds the scenes."""
        return f"virtual-{digest(self.recipe)[:12]}"

    @property
    def place(self) -> Path | str:
        """Return the folder or URL of the scenes."""
        return f"{self.root.rstrip('/')}/{self.name}" if is_url(self.root) else Path(self.root) / self.name

    @property
    def folder(self) -> Path:
        """Return the local folder of the dataset and of data derived from it."""
        return Path(self.root if self.cache is None else self.cache) / self.name

    def scene(self, plan: ScenePlan) -> Recordable:
        """Return the world of one scene."""
        return Scene(theme=plan.theme, seed=plan.seed, rig=self.rig, **self._settings)

    def missing(self, plans: Sequence[ScenePlan] | None = None) -> list[ScenePlan]:
        """Return those of the planned scenes (all of them by default) that are not complete."""
        return [plan for plan in (self.plans if plans is None else plans) if not self._exists(plan)]

    def prepare(self, plans: Sequence[ScenePlan] | None = None) -> None:
        """Render the missing ones of these scenes (None: of all); safe in several processes and after a kill.

        Raises:
            DataError: when the disk refuses, or scenes are missing in an object store.
            RuntimeError: naming scene and frame, when rendering fails.
        """
        missing = self.missing(plans)
        if not missing:
            return
        if isinstance(self.place, str):
            raise DataError(
                f"{self.place}: {len(missing)} scenes are missing, the first is {missing[0].name}. "
                "Rendering writes to local folders only: render with data.source.root=<folder>, then upload that folder"
            )

        def finished() -> int:
            return sum(map(self._exists, missing)) * self.frames_per_scene

        folders = [self.place / plan.name for plan in missing]
        title, total = f"rendering {self.place}", len(missing) * self.frames_per_scene
        with Progress(title, total, finished=finished) as progress:
            make_scenes(partial(record_scene, self), folders, self.workers, progress)

    def labels(self, geometry: Grid, unknown: Unknown) -> VoxelCache:
        """Return the voxel labels of a grid, voted from the recorded points."""
        classes = self.spec.classes.num_classes
        return VoxelCache(self.folder, geometry, unknown, self.fingerprint, classes, self.workers)

    def scenes(self, split: Split) -> list[SceneReader]:
        """Return the scenes of a split, in order; raise DataError when one is missing."""
        plans = [plan for plan in self.plans if plan.split == split]
        for plan in self.missing(plans)[:1]:
            raise DataError(f"{self._where(plan)} is missing: call prepare(), or run `python src/render.py`, first")
        return [self.reader(plan) for plan in plans]

    def reader(self, plan: ScenePlan) -> SceneReader:
        """Return one scene; nothing is opened yet."""
        return SceneReader(self._where(plan))

    @property
    def _settings(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in SETTINGS}

    def _where(self, plan: ScenePlan) -> Path | str:
        return f"{self.place}/{plan.name}" if isinstance(self.place, str) else self.place / plan.name

    def _exists(self, plan: ScenePlan) -> bool:
        if isinstance(self.place, Path):
            return (self.place / plan.name).is_dir()
        try:
            return holds(self._where(plan), META)
        except Exception as error:  # each kind of store has errors of its own
            raise self.reader(plan).unreadable(META, error) from error

    def _plan(self, split: Split, number: int) -> ScenePlan:
        # with 24 + 4 + 4 scenes of eight themes, as in the paper, each theme has four
        first = len(self.themes) // 2 if split == "test" else 0
        theme = self.themes[(first + number) % len(self.themes)]
        # no street is in two splits, for any numbers of scenes
        seed = (self.seed * len(SPLITS) + SPLITS.index(split)) * SEEDS_PER_SPLIT + number
        name = f"{split}-{number:03d}-{theme}" if self.seed == 0 else f"{split}-{number:03d}-{theme}-seed{self.seed}"
        return ScenePlan(name, split, theme, seed)


@cache
def world_spec(frame_interval_s: float) -> SourceSpec:
    """Return the facts about scenes of the virtual world that are recorded at this interval, s."""
    return SourceSpec(WORLD_CLASSES, PAPER_RANGE_EDGES_M, frame_interval_s, EGO_ROAD_M, sparseocc_directions())


def _at_least(name: str, value: int, least: int) -> int:
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    return value


def _one_of(name: str, value: Any, options: Sequence[str]) -> Any:
    if value not in options:
        raise ValueError(f"{name} is {value}: choose one of {', '.join(options)}")
    return value
