"""The virtual world as a source: its scenes, their folder, and their rendering."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Literal, get_args

from omniocc import seeding
from omniocc.bounds import Count, Number, Seconds, Size
from omniocc.camera import Equirectangular, Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.source import SPLITS, Ignore, SourceSpec, Split
from omniocc.data.store.files import holds, is_url
from omniocc.data.store.meta import ORIGIN, RENDERED_REACH_M, SOFTWARE, append_frame, finish_scene, recorded_spec
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META, SCHEMA, SceneWriter, digest
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.parallel import Report, Stopped, make_scenes, usable_cores
from omniocc.progress import Progress
from omniworld.assets.vehicle import EGO_ROAD_M
from omniworld.drawn import DRAWING, DRAWN, VERSION, Origin, check_origin, draw_origin, perturb_rig
from omniworld.fingerprint import variations_code, world_code
from omniworld.plans import Recordable, ScenePlan
from omniworld.render.own_car import mask_ego_car, road_of
from omniworld.render.weather import WEATHERS, Weather, draw_weather
from omniworld.scene import LabelMode, Scene
from omniworld.sensors.recorder import Capture
from omniworld.town.place import ABSTRACT, THEMES
from omniworld.variations import late, night

SEEDS_PER_SPLIT = 1_000_000
PANORAMA = ("erp_size", "erp_top_deg", "erp_bottom_deg")
SETTINGS = ("frame_interval_s", "supersample", *PANORAMA, "weather", "label_mode", "lidars", "capture")
"""Arguments of `Scene` that are equal for all scenes."""
IN_TURN = "in_turn"


class VirtualWorld:
    """A source (`SceneSource`) rendered on first use under `root/virtual-<hash of recipe>`.

    The three splits have disjoint seeds, and therefore different streets. Adding scenes keeps those that exist; every
    change in the content of a frame leads to another folder, so that settings never mix.

    Args:
        root: folder of all datasets, or a URL (memory://, http://, s3:// ...) of data rendered elsewhere.
        rig: built-in rig by name, or a rig file; `random` draws another for each scene, see `omniworld.drawn`.
        image_size: width and height of every camera image, px; those of drawn rigs have about as many pixels.
        themes: kinds of places; the scenes of a split take them in turn, those of the test split from the middle on.
        train_scenes: number of scenes of the training split.
        val_scenes: of the validation split.
        test_scenes: of the test split.
        frames_per_scene: recorded frames of each scene.
        frame_interval_s: time between recorded frames.
        supersample: camera rays per pixel along each side.
        erp_size: width and height of the panorama of ranges, px.
        erp_top_deg: elevation of the panorama's upper edge.
        erp_bottom_deg: elevation of its lower edge.
        weather: of all scenes; None draws one for each by its seed, `in_turn` gives all of them the same share. `night`
            is never drawn.
        label_mode: `lidar20`, points of virtual LiDARs as in the paper, or `geometry`, all surfaces, seen or not.
        lidars: number of virtual LiDARs of `lidar20`.
        capture: `direct`, a ray through every pixel, or `cubemap`, sampled from flat images as in the paper.
        repainted_fraction: fraction of scenes in which materials and colours of all that stands still are exchanged for
            others.
        test_places: those of `themes` that are left out of training and validation; the test consists of them.
        late_camera_ms: how much older than their time stamps the images of one camera are, ms, at most 200; the cameras
            take turns from scene to scene.
        origin_above_road_m: height of the ego origin, in which voxels and ranges are, above the road, m; `drawn` draws
            one for each scene, from that of the rig to that of most voxel grids; None leaves it where the rig has it.
        seed: of the streets in all splits.
        shard_limit_mib: size at which a new tar shard begins, MiB.
        workers: processes that render; 0 renders in this process, None takes all usable cores.
        cache: folder for derived data (voxels); None puts it beside the scenes. A URL as root needs one.

    Raises:
        ValueError: naming the option that is impossible.
    """

    def __init__(
        self,
        root: str,
        rig: str,
        image_size: Sequence[Size],
        themes: Sequence[str],
        train_scenes: int,
        val_scenes: int,
        test_scenes: int,
        frames_per_scene: Number,
        frame_interval_s: Seconds,
        supersample: Count,
        erp_size: Sequence[Size],
        erp_top_deg: float,
        erp_bottom_deg: float,
        weather: Weather | Literal["night", "in_turn"] | None = None,
        label_mode: LabelMode = "lidar20",
        lidars: Count = 20,
        capture: Capture = "direct",
        repainted_fraction: float = 0.0,
        test_places: Sequence[str] = (),
        late_camera_ms: float = 0.0,
        origin_above_road_m: Origin = None,
        seed: int = 0,
        shard_limit_mib: int = 256,
        workers: int | None = None,
        cache: str | None = None,
    ):
        if is_url(root) and cache is None:
            raise ValueError(f"root is a URL ({root}): set cache to a local folder, where voxels are kept")
        self.root, self.cache = root, cache
        self.rig_name = rig
        self.rig = None if rig in DRAWING else _resized(rig, image_size)
        self.pixels = image_size[0] * image_size[1]
        self.themes = tuple(themes)
        self.num_scenes = {"train": train_scenes, "val": val_scenes, "test": test_scenes}
        self.frames_per_scene = _at_least("frames_per_scene", frames_per_scene, 1)
        self.frame_interval_s = float(frame_interval_s)
        self.supersample = _at_least("supersample", supersample, 1)
        self.erp_size = tuple(erp_size)
        self.erp_top_deg, self.erp_bottom_deg = float(erp_top_deg), float(erp_bottom_deg)
        Equirectangular(erp_size[0], erp_size[1], self.erp_top_deg, self.erp_bottom_deg)  # checks the edges
        self.weather = None if weather is None else _one_of("weather", weather, (*WEATHERS, night.NIGHT, IN_TURN))
        self.label_mode: LabelMode = _one_of("label_mode", label_mode, get_args(LabelMode))
        self.lidars = _at_least("lidars", lidars, 1)
        self.capture: Capture = _one_of("capture", capture, get_args(Capture))
        if not 0 <= repainted_fraction <= 1:
            raise ValueError(f"repainted_fraction is {repainted_fraction}; it must be from 0 to 1")
        self.repainted_fraction = float(repainted_fraction)
        if not 0 <= late_camera_ms <= late.LONGEST_MS:
            raise ValueError(f"late_camera_ms is {late_camera_ms}; it must be from 0 to {late.LONGEST_MS:g}")
        self.late_camera_ms = float(late_camera_ms)
        self.origin_above_road_m = check_origin(origin_above_road_m)
        self.seed = _at_least("seed", seed, 0)
        self.shard_limit_bytes = _at_least("shard_limit_mib", shard_limit_mib, 1) * 2**20
        self.workers = usable_cores() if workers is None else _at_least("workers", workers, 0)
        known = (*THEMES, *ABSTRACT)
        if not self.themes or not set(self.themes) <= set(known):
            raise ValueError(f"themes are {list(self.themes)}: choose one or more of {', '.join(known)}")
        self.test_places = tuple(test_places)
        if self.test_places and not set(self.test_places) < set(self.themes):
            raise ValueError(
                f"test_places are {list(self.test_places)}: choose some of the themes, and leave others for training "
                f"({', '.join(self.themes)})"
            )
        for split, count in self.num_scenes.items():
            if not 0 <= count < SEEDS_PER_SPLIT:
                raise ValueError(f"{split}_scenes must be from 0 to {SEEDS_PER_SPLIT - 1}, got {count}")

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """Return everything that decides the content of a scene's frames, except theme and seed."""
        return {
            "schema": SCHEMA,
            "world": world_code(),
            "rig": f"{self.rig_name} {VERSION} {self.pixels}" if self.rig is None else self.rig.fingerprint,
            "frames_per_scene": self.frames_per_scene,
            **self._settings,
            "erp_size": list(self.erp_size),
            "shard_limit_bytes": self.shard_limit_bytes,
            **({"repainted_fraction": self.repainted_fraction} if self.repainted_fraction else {}),
            **({"late_camera_ms": self.late_camera_ms} if self.late_camera_ms else {}),
            **({} if self.origin_above_road_m is None else {ORIGIN: self.origin_above_road_m}),
            **({"variations": variations_code()} if self.late_camera_ms or self.weather == night.NIGHT else {}),
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
        """Return the classes, bands and rays of the virtual world, and the road's height, None if scenes differ."""
        if isinstance(self.origin_above_road_m, float):
            return world_spec(self.frame_interval_s, -self.origin_above_road_m)
        one_height = None if self.rig is None or self.origin_above_road_m == DRAWN else road_of(self.rig)
        return world_spec(self.frame_interval_s, one_height)

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
        draw, weather = seeding.generator(plan.theme, plan.seed, "repainted").uniform(), self.weather_of(plan)
        kind, weather = (night.NightScene, night.BASE) if weather == night.NIGHT else (Scene, weather)
        rig, settings = self.rig_of(plan), {**self._settings, "weather": weather}
        scene = kind(plan.theme, plan.seed, rig, repaint=draw < self.repainted_fraction, **settings)
        if not self.late_camera_ms:
            return scene
        return late.LateCamera(scene, plan.seed % len(rig.cameras), self.late_camera_ms / 1000, plan.seed)

    def themes_of(self, split: Split) -> tuple[str, ...]:
        """Return the kinds of places in a split."""
        if not self.test_places:
            return self.themes
        return tuple(theme for theme in self.themes if (theme in self.test_places) == (split == "test"))

    def rig_of(self, plan: ScenePlan) -> Rig:
        """Return the cameras of one scene, in its ego frame."""
        rig = self.rig or DRAWING[self.rig_name](seeding.generator(plan.theme, plan.seed, "rig"), self.pixels)
        origin_m = self.origin_above_road_m
        if origin_m is None:
            return rig
        road_m = road_of(rig)
        if isinstance(origin_m, str):
            origin_m = draw_origin(seeding.generator(plan.theme, plan.seed, "origin"), -road_m)
        return replace(rig, road_z_m=road_m).raised(road_m + origin_m)

    def calibration_of(self, plan: ScenePlan) -> Rig:
        """Return the cameras of one scene as they are recorded: with masks, drawn rigs with errors of their poses."""
        masked = mask_ego_car(self.rig_of(plan))
        if self.rig is not None:
            return masked
        return perturb_rig(seeding.generator(plan.theme, plan.seed, "calibration"), masked)

    def weather_of(self, plan: ScenePlan) -> str:
        """Return the weather of one scene."""
        if self.weather is None:
            return draw_weather(seeding.generator(plan.theme, plan.seed, "light"))
        if self.weather != IN_TURN:
            return self.weather
        turn, theme = divmod(plan.seed % SEEDS_PER_SPLIT, len(self.themes_of(plan.split)))
        return WEATHERS[(turn + theme) % len(WEATHERS)]

    @property
    def made_here(self) -> bool:
        """Return whether missing scenes are rendered on this machine; those below a URL are not."""
        return not is_url(self.root)

    def planned_rig(self) -> Rig:
        """Return the cameras of the first training scene."""
        return self.rig if self.rig is not None and self.origin_above_road_m is None else self.rig_of(self.plans[0])

    def planned(self, split: Split) -> dict[str, int]:
        """Return the numbers of frames of the scenes of a split, by name, in order."""
        return {plan.name: self.frames_per_scene for plan in self.plans if plan.split == split}

    def made(self, split: Split, names: Sequence[str]) -> list[SceneReader]:
        """Return some scenes of a split, after those that are missing have been rendered."""
        plans = {plan.name: plan for plan in self.plans if plan.split == split}
        self.prepare(chosen := [plans[name] for name in names])
        return [self.reader(plan) for plan in chosen]

    def missing(self, plans: Sequence[ScenePlan] | None = None) -> list[ScenePlan]:
        """Return those of the planned scenes (all of them by default) that are not complete."""
        return [plan for plan in (self.plans if plans is None else plans) if not self._exists(plan)]

    def prepare(self, plans: Sequence[ScenePlan] | None = None) -> None:
        """Render the missing ones of these scenes (None: of all); safe in several processes and after a kill.

        Raises:
            DataError: when the disk refuses, or scenes are missing in an object store.
            RuntimeError: naming scene and frame, when rendering fails.
        """
        if not (missing := self.missing(plans)):
            return
        if isinstance(self.place, str):
            raise DataError(
                f"{self.place}: {len(missing)} scenes are missing, the first is {missing[0].name}. "
                "Rendering writes to local folders only: render with data.source.root=<folder>, then upload that folder"
            )
        each, title = self.frames_per_scene, f"rendering {self.place}"
        with Progress(title, len(missing) * each, finished=lambda: sum(map(self._exists, missing)) * each) as progress:
            folders = [self.place / plan.name for plan in missing]
            make_scenes(partial(record_scene, self), folders, self.workers, progress)

    def labels(self, geometry: Grid, ignore: Ignore) -> VoxelCache:
        """Return the voxel labels of a grid, voted from the recorded points."""
        classes = self.spec.classes.num_classes
        return VoxelCache(
            self.folder, geometry, ignore, self.fingerprint, classes, self.workers, reach_m=RENDERED_REACH_M
        )

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
        themes = self.themes_of(split)
        theme = themes[(number + (len(themes) // 2 if split == "test" else 0)) % len(themes)]
        # no street is in two splits, for any numbers of scenes
        seed = (self.seed * len(SPLITS) + SPLITS.index(split)) * SEEDS_PER_SPLIT + number
        name = f"{split}-{number:03d}-{theme}" if self.seed == 0 else f"{split}-{number:03d}-{theme}-seed{self.seed}"
        return ScenePlan(name, split, theme, seed)


def record_scene(world: VirtualWorld, folder: Path, report: Report) -> None:
    """Render the frames of a planned scene into its folder, unless it is complete.

    Raises:
        RuntimeError: naming scene and frame, when the world fails.
    """
    with closing(SceneWriter(folder, world.shard_limit_bytes)) as writer:
        if writer.finished:
            report(world.frames_per_scene)
            return
        plan = next(plan for plan in world.plans if plan.name == folder.name)
        _record_frames(world, plan, writer, report)
        facts = {"split": plan.split, "theme": plan.theme, "seed": plan.seed, "weather": world.weather_of(plan)}
        facts["recipe"] = world.recipe
        edges_deg = world.erp_top_deg, world.erp_bottom_deg
        finish_scene(writer, world.calibration_of(plan), world.spec, edges_deg, facts, (*SOFTWARE, "embreex"))


def _record_frames(world: VirtualWorld, plan: ScenePlan, writer: SceneWriter, report: Report) -> None:
    index = 0
    try:
        scene = world.scene(plan)
        for index in range(world.frames_per_scene):
            append_frame(writer, scene.frame(index))
            report(1)
    except (DataError, Stopped):
        raise
    except Exception as error:  # of any kind: the message names scene and frame
        raise RuntimeError(f"scene {plan.name}, frame {index}: {type(error).__name__}: {error}") from error


@cache
def world_spec(frame_interval_s: float, road_z_m: float | None = EGO_ROAD_M) -> SourceSpec:
    """Return the facts about scenes of the virtual world at this interval, s, and height of the road, m, ego frame."""
    return recorded_spec(WORLD_CLASSES, frame_interval_s, road_z_m)


def _resized(rig: str, image_size: Sequence[int]) -> Rig:
    try:
        return Rig.load(rig).resized(*image_size)
    except ValueError as error:
        raise ValueError(f"rig={rig}, image_size={list(image_size)}: {error}") from error


def _at_least(name: str, value: int, least: int) -> int:
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    return value


def _one_of(name: str, value: Any, options: Sequence[str]) -> Any:
    if value not in options:
        raise ValueError(f"{name} is {value}: choose one of {', '.join(options)}")
    return value
