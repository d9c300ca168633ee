"""The world of the stand-in for a CARLA server, once a town is loaded: traffic, cameras and LiDAR."""

import os
import signal
import time
import types
from pathlib import Path

import carla as real
import numpy as np
import torch
from stand_in import Idle, options

from omniocc.camera import Pinhole, Rig
from omniocc.classes import WORLD_CLASSES
from omniworld import Scene
from omniworld.render.capture import expose, render_pixels
from omniworld.render.caster import Caster
from omniworld.render.own_car import car_under
from omniworld.render.view import make_view

NEW_TAGS = {"Free": 11, "Road": 1, "Sidewalk": 2, "Ground": 25, "Building": 3, "Wall": 4, "Vegetation": 9}
NEW_TAGS |= {"Vehicle": 14, "Other": 22, "Pole": 6, "Pedestrian": 12, "Roadline": 24}
CAR_M = (2.31, 1.08, 0.825)
"""Half the size of the ego vehicle."""
# Axes of a camera's image in its sensor frame (x forward, y right, z up), as CARLA's tutorials give them.
IMAGE_RIGHT, IMAGE_DOWN, IMAGE_AHEAD = (0, 1, 0), (0, 0, -1), (1, 0, 0)


def flipped(matrix):
    """A matrix between a left-handed and a right-handed frame that differ in the sign of y."""
    mirror = np.diag([1.0, -1, 1, 1])
    return mirror @ matrix @ mirror


def transform_of(pose):
    """The real client's Transform of a right-handed pose; its own matrix must give the pose back."""
    left = flipped(pose)
    pitch = np.degrees(np.arcsin(np.clip(left[2, 0], -1, 1)))
    yaw = np.degrees(np.arctan2(left[1, 0], left[0, 0]))
    roll = np.degrees(np.arctan2(-left[2, 1], left[2, 2]))
    found = real.Transform(real.Location(*map(float, left[:3, 3])), real.Rotation(pitch=pitch, yaw=yaw, roll=roll))
    np.testing.assert_allclose(found.get_matrix(), left, atol=2e-3)
    return found


class Blueprint:
    def __init__(self, name):
        self.id, self.attributes = name, {}

    def set_attribute(self, name, value):
        assert isinstance(value, str), "attributes are strings"
        self.attributes[name] = value


class Library:
    KINDS = ("vehicle.tesla.model3", "vehicle.audi.tt", "walker.pedestrian.0001", "controller.ai.walker")
    SENSORS = ("camera.rgb", "camera.depth", "camera.semantic_segmentation", "lidar.ray_cast_semantic")

    def find(self, name):
        assert name in (*self.KINDS, *(f"sensor.{kind}" for kind in self.SENSORS)), name
        return Blueprint(name)

    def filter(self, pattern):
        return [Blueprint(name) for name in self.KINDS if name.startswith(pattern.rstrip("*"))]


class Actor:
    """Something in the world; its pose is that of the world's traffic."""

    def __init__(self, world, number):
        self.world, self.id = world, number

    def destroy(self):
        pass

    def set_autopilot(self, on, port):
        assert on
        assert port == 8000


class Ego(Actor):
    bounding_box = real.BoundingBox(real.Location(0, 0, CAR_M[2]), real.Vector3D(*CAR_M))

    def pose(self):
        low = np.eye(4)
        low[2, 3] = self.world.road_z_m
        return self.world.world_from_ego @ low

    def get_transform(self):
        return transform_of(self.pose())


class Other(Actor):
    """A vehicle or walker of the traffic, by its place in the list of actors near the ego."""

    def __init__(self, world, number, actor):
        super().__init__(world, number)
        self.actor = actor

    @property
    def bounding_box(self):
        length, width, height = self.actor.size_m
        return real.BoundingBox(real.Location(0, 0, height / 2), real.Vector3D(length / 2, width / 2, height / 2))

    def now(self):
        return next((actor for actor in self.world.actors if actor.id == self.actor.id), self.actor)

    def get_transform(self):
        return transform_of(self.now().world_from_actor)

    def get_velocity(self):
        x, y = self.now().velocity_mps
        return real.Vector3D(float(x), -float(y), 0.0)

    def set_collisions(self, on):
        assert on

    def set_simulate_physics(self, on):
        assert on


class Controller(Actor):
    def start(self):
        pass

    def stop(self):
        pass

    def go_to_location(self, place):
        pass

    def set_max_speed(self, speed):
        assert speed > 0


class Data:
    def __init__(self, frame, timestamp, transform, raw_data):
        self.frame, self.timestamp, self.transform = frame, timestamp, transform
        self.raw_data = memoryview(raw_data)


class Pose:
    """A transform whose matrix is not limited to float32 angles."""

    def __init__(self, matrix):
        self.matrix = matrix

    def get_matrix(self):
        return self.matrix.tolist()


class Sensor(Actor):
    def __init__(self, world, number, blueprint, transform):
        super().__init__(world, number)
        self.kind, self.attributes, self.transform = blueprint.id, blueprint.attributes, transform
        self.callback = None

    def listen(self, callback):
        self.callback = callback

    def stop(self):
        self.callback = None

    def mounted(self):
        """The pose on the vehicle, right-handed."""
        matrix = np.array(self.transform.get_matrix())
        return matrix if options()["mirror"] else flipped(matrix)

    def send(self):
        if self.callback is None:
            return
        raw = self.scan() if "lidar" in self.kind else self.image()
        pose = Pose(flipped(self.world.ego.pose() @ self.mounted()))
        self.callback(Data(self.world.frame, self.world.time_s, pose, raw))

    def image(self):
        view, seen = self.world.rendered(self)
        side = int(self.attributes["image_size_x"])
        pixels = np.zeros((side * side, 4), np.uint8)
        if self.kind.endswith("rgb"):
            image = expose(view, seen, self.world.scene._light, self.world.scene.sensor, np.random.default_rng(0))
            pixels[:, :3] = image.rgb.reshape(-1, 3)[:, ::-1]
        elif self.kind.endswith("depth"):
            ahead = view.ahead * seen.range_m * options()["depth_scale"]
            code = np.rint(np.minimum(ahead, 1000.0) / 1000 * (2**24 - 1)).astype(np.uint32)
            pixels[view.pixel] = np.stack([code >> 16, code >> 8 & 255, code & 255, code * 0], axis=1)
        else:
            label = np.where(seen.ego, WORLD_CLASSES.names.index("Vehicle"), seen.label)
            pixels[view.pixel, 2] = self.world.tags[label]
        return pixels.tobytes()

    def scan(self):
        a = {name: float(value) for name, value in self.attributes.items()}
        columns = round(a["points_per_second"] / a["channels"] / a["rotation_frequency"])
        up = np.radians(np.linspace(a["lower_fov"], a["upper_fov"], int(a["channels"])))
        round_ = np.arange(columns) * 2 * np.pi / columns
        up, round_ = (part.ravel() for part in np.meshgrid(up, round_, indexing="ij"))
        rays = np.stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])  # y to the right
        pose = np.linalg.inv(self.world.world_from_ego) @ self.world.ego.pose() @ self.mounted()
        turned = pose[:3, :3] @ (rays * np.array([[1], [-1], [1]]))
        return self.points(rays, self.world.snapshot.cast(pose[:3, 3], turned.astype(np.float32)), a["range"])

    def points(self, rays, hits, reach_m):
        snapshot = self.world.snapshot
        hit = np.flatnonzero((hits.face >= 0) & (hits.range_m < reach_m))
        face, offset = hits.face[hit], int(snapshot.layers.offsets[1])
        label = snapshot.surfaces.label[face].astype(int)
        label[label == WORLD_CLASSES.names.index("Roadline")] = WORLD_CLASSES.names.index("Road")
        moving = face >= offset
        actor = np.zeros(len(face), np.uint32)
        actor[moving] = self.world.numbers_of(snapshot.moving.instance[face[moving] - offset])
        dtype = [("p", "<f4", 3), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")]
        found = np.zeros(len(face), dtype)
        found["p"], found["actor"], found["tag"] = (rays[:, hit] * hits.range_m[hit]).T, actor, self.world.tags[label]
        return found.tobytes()


class World(Idle):
    """A town that is loaded, with its traffic."""

    def __init__(self):
        super().__init__()
        given = options()
        self.rig = Rig.load(given["rig"])
        self.scene = Scene(given["theme"], given["seed"], self.rig, supersample=1, weather="clear", lidars=1)
        self.road_z_m = -2.2 if self.rig.road_z_m is None else self.rig.road_z_m
        self.tags = np.zeros(256, np.uint8)
        for name, tag in (given["tags"] or NEW_TAGS).items():
            self.tags[WORLD_CLASSES.names.index(name)] = tag
        self.ego, self.sensors, self.others, self.views, self.images = Ego(self, 7), [], {}, {}, {}
        self.advance(0.0)

    def advance(self, time_s):
        self.snapshot, self.actors = self.scene.snapshot(time_s)
        self.world_from_ego = self.scene._world_from_ego(time_s)
        self.images = {}

    def numbers_of(self, instances):
        """Return the numbers of actors in CARLA: their numbers in the virtual world + 100; 0 for those not spawned."""
        return np.where(np.isin(instances, list(self.others)), instances + 100, 0)

    def rendered(self, sensor):
        """Return view and pixels of a pinhole camera; its color, depth and class images come from one rendering."""
        side, field = int(sensor.attributes["image_size_x"]), np.radians(float(sensor.attributes["fov"]))
        mounted = sensor.mounted()
        key = side, mounted.round(6).tobytes()
        if key not in self.views:
            axes = np.array([IMAGE_RIGHT, IMAGE_DOWN, IMAGE_AHEAD], float).T * np.array([[1], [-1], [1]])
            pose = np.eye(4)
            pose[:3, :3] = axes
            low = np.eye(4)
            low[2, 3] = self.road_z_m
            focal = side / 2 / np.tan(field / 2)
            camera = Pinhole(side, side, (focal, focal), ((side - 1) / 2,) * 2)
            rig = Rig((camera,), torch.from_numpy((low @ mounted @ pose)[None]), ("face",), None, self.road_z_m)
            view = make_view(rig, 0, 1, Caster(car_under(self.rig)))
            object.__setattr__(view, "ahead", (low @ mounted @ pose)[:3, 2] @ view.center)
            self.views[key] = view
        if key not in self.images:
            self.images[key] = render_pixels(self.views[key], self.snapshot)
        return self.views[key], self.images[key]

    def get_map(self):
        places = [real.Transform() for _ in range(200)]
        return types.SimpleNamespace(name="Carla/Maps/Town01", get_spawn_points=lambda: places)

    def get_blueprint_library(self):
        return Library()

    def set_weather(self, weather):
        assert isinstance(weather, real.WeatherParameters)

    def set_pedestrians_seed(self, seed):
        assert isinstance(seed, int)

    def get_random_location_from_navigation(self):
        return real.Location(0, 0, 0)

    def try_spawn_actor(self, blueprint, transform):
        if blueprint.attributes.get("role_name") == "hero":
            return self.ego
        kind = "Vehicle" if blueprint.id.startswith("vehicle.") else "Pedestrian"
        free = [a for a in self.actors if a.id not in self.others and WORLD_CLASSES.names[a.label] == kind]
        if not free:
            return None
        self.others[free[0].id] = Other(self, free[0].id + 100, free[0])
        return self.others[free[0].id]

    def spawn_actor(self, blueprint, transform, attach_to=None, attachment_type=None):
        if blueprint.id == "controller.ai.walker":
            return Controller(self, 1)
        assert attach_to is self.ego
        assert attachment_type == real.AttachmentType.Rigid
        self.sensors.append(Sensor(self, len(self.sensors) + 5000, blueprint, transform))
        return self.sensors[-1]

    def tick(self, seconds=10.0):
        self.fail()
        self.ticks += 1
        self.frame += 1
        self.time_s += self.get_settings().fixed_delta_seconds or 0.1
        self.advance(0.0 if options()["still"] else (self.time_s - 50.0))
        for sensor in self.sensors[1:] if self.fault_now("late") else self.sensors:
            sensor.send()
        return self.frame

    def fault_now(self, kind):
        given = options()
        over = given["once"] is not None and Path(given["once"]).exists()
        now = given["fault"] == kind and self.ticks == given["at"] and not over
        if now and given["once"] is not None:
            Path(given["once"]).touch()
        return now

    def fail(self):
        if self.fault_now("crash"):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.fault_now("hang"):
            time.sleep(3600)
