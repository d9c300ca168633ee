"""Record a dataset on a CARLA server, whatever server and machine do meanwhile."""

import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import torch

from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.data.formats.poses import inverse
from omniocc.data.source import SPLITS, Split
from omniocc.data.store.meta import append_frame, finish_scene, panorama_of, recorded_spec
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.extras.carla_tags import class_table, tags_of
from omniocc.extras.recorders import Finding
from omniocc.extras.recorders.carla.check import check_frames
from omniocc.extras.recorders.carla.frames import RawFrame, make_frame, vehicle_in_ego
from omniocc.extras.recorders.carla.process import CarlaError, Message, captured
from omniocc.extras.recorders.carla.sensors import Cube, Spec, camera_cubes, cube_sensors, lidar_sensors, origin_cube
from omniocc.io import checked_name
from omniocc.lock import Held, acquire
from omniocc.progress import Progress
from omniworld.render.own_car import grown, masking, road_of, show_ego_car

WEATHERS = ("ClearNoon", "CloudyNoon", "WetNoon", "HardRainNoon", "ClearSunset", "CloudySunset", "WetSunset")
"""Weathers that scenes take in turn where none is given: presets of `carla.WeatherParameters`."""
CHECKED_FRAMES = 5
SETTLE_S = 15.0
"""Time that a server gets to start again, s."""


class Plan(NamedTuple):
    """One scene: its name, split, town, weather, and the seed of traffic and LiDARs."""

    name: str
    split: Split
    town: str
    weather: str
    seed: int


class CarlaRecorder:
    """Record scenes of CARLA's towns, one after another.

    A scene is written under another name until it is whole. One that was interrupted is begun again, since traffic
    cannot be repeated; whole scenes are kept, so that the same command goes on after a stop.

    Args:
        host: of the server.
        port: of the server.
        traffic_port: of its Traffic Manager.
        python: command of a Python (3.8 or newer) with the client of the server's version; None: this one.
        restart: command that starts the server again after a crash, such as `docker restart carla`; None: wait for it.
        maps: towns, which the scenes take in turn.
        scenes: number of scenes.
        frames: of each scene.
        warm_up: frames before these that are thrown away, while exposure and traffic settle.
        interval_s: time between frames, s; the server's physics takes at most .1 s.
        weather: presets of `carla.WeatherParameters` that scenes take in turn; None: `WEATHERS`.
        vehicles: other vehicles.
        walkers: pedestrians.
        ego: blueprint of the ego vehicle.
        rig: rig file or built-in rig; the road is as far below its origin as it says (`road_z_m`), or else 2.2 m.
        image_size: width and height of every image, px.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of ranges.
        lidars: semantic LiDARs whose points vote for voxels.
        camera: attributes of the colour cameras, as CARLA calls them.
        splits: train, val or test, which the scenes take in turn.
        seed: of all scenes.
        timeout_s: longest wait for an answer of the server, s.
        load_s: longest time that loading a town takes, s.
        stuck_s: time after which an ego vehicle that stands still is given up, s.
        attempts: how often a scene is begun.

    Raises:
        ValueError: naming the argument that is impossible.
    """

    def __init__(
        self,
        host: str,
        port: int,
        traffic_port: int,
        python: str | None,
        restart: str | None,
        maps: Sequence[str],
        scenes: int,
        frames: int,
        warm_up: int,
        interval_s: float,
        weather: Sequence[str] | None,
        vehicles: int,
        walkers: int,
        ego: str,
        rig: str,
        image_size: tuple[int, int],
        panorama: tuple[int, int, float, float],
        lidars: int,
        camera: dict[str, Any] | None,
        splits: Sequence[Split],
        seed: int,
        timeout_s: float,
        load_s: float,
        stuck_s: float,
        attempts: int,
    ):
        for name, value, least in (
            ("scenes", scenes, 1),
            ("frames", frames, 1),
            ("warm_up", warm_up, 0),
            ("lidars", lidars, 1),
            ("attempts", attempts, 1),
        ):
            if value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")
        for name, value in (("port", port), ("traffic_port", traffic_port)):
            if not 0 < value < 2**16:
                raise ValueError(f"{name} is {value}; ports are from 1 to 65535")
        if not 0 < interval_s <= 0.1:
            raise ValueError(f"interval_s is {interval_s}; it must be above 0, and CARLA's physics allows at most .1 s")
        if not maps:
            raise ValueError("maps must name one town or more, such as [Town01,Town02]")
        for town in maps:  # files of its scenes are called by it
            checked_name("maps: a town", town)
        if not splits or not set(splits) <= set(SPLITS):
            raise ValueError(f"splits must be of {', '.join(SPLITS)}, got {list(splits)}")
        self.python = [sys.executable] if python is None else shlex.split(python)
        self.restart = None if restart is None else shlex.split(restart)
        self.maps, self.weather = tuple(maps), tuple(weather or WEATHERS)
        self.scenes, self.frames, self.interval_s, self.seed = scenes, frames, interval_s, seed
        self.rig = show_ego_car(Rig.load(rig).resized(*image_size))  # CARLA has cars of other shapes
        self.vehicle_from_ego = inverse(vehicle_in_ego(self.rig))
        self.panorama, self.lidars, self.camera = panorama_of(panorama), lidars, dict(camera or {})
        self.splits, self.attempts = tuple(splits), attempts
        self.load_s, self.silence_s = load_s, 2 * timeout_s
        self._job = {
            "host": host,
            "port": port,
            "traffic_port": traffic_port,
            "connect_s": min(10.0, timeout_s),
            "timeout_s": timeout_s,
            "load_s": load_s,
            "warm_up": warm_up,
            "frames": frames,
            "interval_s": interval_s,
            "vehicles": vehicles,
            "walkers": walkers,
            "ego": ego,
            "stuck_s": stuck_s,
        }

    @property
    def plans(self) -> list[Plan]:
        """Return all scenes."""
        found = []
        for number in range(self.scenes):
            town = self.maps[number % len(self.maps)]
            weather = self.weather[(number // len(self.maps) + number) % len(self.weather)]
            split = self.splits[number % len(self.splits)]
            found.append(Plan(f"{split}-{number:03d}-{town}", split, town, weather, 1000 * self.seed + number))
        return found

    def record(self, root: Path) -> list[Path]:
        """Record the scenes that are missing in a folder and return all of them.

        Raises:
            CarlaError: when the server cannot be used, or a scene failed as often as allowed.
            DataError: when the disk refuses.
        """
        root.mkdir(parents=True, exist_ok=True)
        plans = self.plans
        missing = [plan for plan in plans if not self._is_made(root / plan.name, plan)]
        with self._alone(root), Progress(f"recording {root}", len(missing) * self.frames) as progress:
            for plan in missing:
                self._record_scene(root / plan.name, plan, progress)
        return [root / plan.name for plan in plans]

    def recipe(self, plan: Plan) -> str:
        """Return a hash of everything that decides a scene but for the server."""
        of_server = ("host", "port", "traffic_port", "connect_s", "timeout_s", "load_s", "stuck_s", "restore")
        job = {key: value for key, value in self.job(plan).items() if key not in of_server}
        panorama = [self.panorama.width, self.panorama.height, self.panorama.top_deg, self.panorama.bottom_deg]
        return digest([job, list(plan), self.rig.fingerprint, panorama])

    def _is_made(self, folder: Path, plan: Plan) -> bool:
        """Return whether a scene exists; raise DataError if it was recorded with other options."""
        if not folder.is_dir():
            return False
        if SceneReader(folder).meta["facts"].get("recipe") != self.recipe(plan):
            raise DataError(
                f"{folder}: there is a scene recorded with other options (rig, sensors, traffic, frames or seed); "
                "choose another output=..., or remove it"
            )
        return True

    def sensors(self, seed: int) -> list[Spec]:
        """Return the sensors of a scene."""
        cubes = [*self.cameras, self.origin]
        flat = [sensor for cube in cubes for sensor in cube_sensors(cube, self.vehicle_from_ego, self.camera)]
        return [*flat, *lidar_sensors(self.lidars, self.interval_s, seed)]

    @cached_property
    def cameras(self) -> list[Cube]:
        """Return the cubes of the cameras."""
        return camera_cubes(self.rig)

    @cached_property
    def origin(self) -> Cube:
        """Return the cube around the ego origin."""
        return origin_cube(self.panorama)

    def job(self, plan: Plan) -> dict[str, Any]:
        """Return the job of the capturing process."""
        return self._job | {
            "town": plan.town,
            "weather": plan.weather,
            "seed": plan.seed,
            "sensors": self.sensors(plan.seed),
        }

    def raw_frame(self, message: Message) -> RawFrame:
        """Return the frame that a message holds."""
        header = message.header
        return RawFrame(
            number=header["number"],
            time_s=header["time_s"],
            world_from_vehicle=header["world_from_vehicle"],
            ego_id=header["ego_id"],
            ego_box=header["ego_box"],
            actors=header["actors"],
            matrices=header["matrices"],
            raw=message.blobs,
        )

    def check(self) -> list[Finding]:
        """Return what a few frames in the first town say about our assumptions; nothing is written.

        Raises:
            CarlaError: when the server cannot be used.
        """
        plan = self.plans[0]
        job: dict[str, Any] = self.job(plan) | {"frames": CHECKED_FRAMES}
        with captured(self.python, job, self.load_s, self.silence_s) as messages:
            classes = class_table(tags_of(next(messages).header["server"]))
            frames = [self.raw_frame(message) for message in messages if message.kind == "frame"]
        return check_frames(frames, job["sensors"], self.origin, self.interval_s, classes)

    @contextmanager
    def _alone(self, root: Path) -> Iterator[None]:
        try:
            lock = acquire(root / ".recording.lock")
        except Held as held:
            raise UserError(f"{root}: another process is recording into this folder{held.remedy}") from held
        try:
            yield
        finally:
            lock.release()

    def _record_scene(self, folder: Path, plan: Plan, progress: Progress) -> None:
        for attempt in range(self.attempts):
            done = 0
            try:
                tried = plan._replace(seed=plan.seed + 500_000 * attempt)  # other traffic than the one that failed
                for _ in self._frames(folder, tried, self.recipe(plan)):
                    progress.advance()
                    done += 1
                return
            except CarlaError as error:
                self._release_server()
                if error.lasting or attempt + 1 == self.attempts:
                    raise CarlaError(f"scene {plan.name}: {error}; the same command goes on", True) from error
                progress.advance(-done)
                print(f"scene {plan.name}: {error}; it is begun again", flush=True)
                self._restart_server()

    def _frames(self, folder: Path, plan: Plan, recipe: str) -> Iterator[None]:
        """Record one scene; yield after every frame."""
        with (
            closing(SceneWriter(folder)) as writer,
            captured(self.python, self.job(plan), self.load_s, self.silence_s) as messages,
        ):
            hello, rig, first_s = next(messages).header, self.rig, 0.0
            tags = tags_of(hello["server"])
            classes = class_table(tags)
            for raw in (self.raw_frame(message) for message in messages if message.kind == "frame"):
                first_s = first_s if writer.num_frames else raw.time_s
                frame, own_car = make_frame(
                    raw, first_s, self.rig, self.cameras, self.origin, self.panorama, classes=classes
                )
                if writer.num_frames == 0:
                    rig = masking(self.rig, grown(tuple(torch.from_numpy(part) for part in own_car), 1))
                append_frame(writer, frame)
                yield
            facts = {"recorder": "carla", "theme": plan.town, **plan._asdict(), "tags": tags, "lidars": self.lidars}
            facts |= {"recipe": recipe} | {key: hello[key] for key in ("server", "client")}
            facts |= {key: self._job[key] for key in ("vehicles", "walkers", "ego")}
            spec = recorded_spec(WORLD_CLASSES, self.interval_s, road_of(self.rig))
            edges_deg = self.panorama.top_deg, self.panorama.bottom_deg
            finish_scene(writer, rig, spec, edges_deg, facts)

    def _release_server(self) -> None:
        """Let a server run freely that a killed process left waiting; it may be gone."""
        job = self._job | {"restore": True, "timeout_s": self._job["connect_s"]}
        with suppress(CarlaError), captured(self.python, job, self.load_s, self.silence_s) as messages:
            for _ in messages:
                pass

    def _restart_server(self) -> None:
        if self.restart is not None:
            result = subprocess.run(self.restart, capture_output=True, text=True, check=False)
            if result.returncode:
                said = (result.stderr or result.stdout).strip().splitlines()[-1:]
                raise CarlaError(f"recorder.restart={shlex.join(self.restart)} failed: {' '.join(said)}", True)
            time.sleep(SETTLE_S)
