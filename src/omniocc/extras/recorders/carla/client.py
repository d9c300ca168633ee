"""Capture frames from a CARLA server and write them to standard output, for `omniocc.extras.recorders.carla.process`.

This file stands alone: it needs only the module `carla` and Python 3.8 or newer, since a client must be as old as its
server. It reads one line of JSON, the job, and writes messages: 8 bytes with the length of a JSON header, the header,
then the bytes of the blobs that the header lists as [name, size].
"""

import json
import os
import queue
import random
import signal
import struct
import sys
import time

RIGID = "Rigid"
WALKER_SPEED_MPS = 1.4
STUCK_M = 1.0


class RecordingError(Exception):
    """An end of the recording that has a reason for users; `kind` tells the recorder what to do."""

    def __init__(self, kind, message):
        super().__init__(message)
        self.kind = kind


class Messages:
    """Messages to the recorder, on the standard output that only this object writes to."""

    def __init__(self):
        self._file = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what libraries print goes to standard error

    def send(self, header, blobs=()):
        """Write one message."""
        header = dict(header, blobs=[[name, len(content)] for name, content in blobs])
        line = json.dumps(header).encode()
        self._file.write(struct.pack("<Q", len(line)) + line)
        for _, content in blobs:
            self._file.write(content)
        self._file.flush()


def main():
    """Run the job from standard input; the last message is `done` or `failed`."""
    messages = Messages()
    signal.signal(signal.SIGTERM, _leave)
    job = json.loads(sys.stdin.readline())
    try:
        try:
            import carla
        except ImportError as error:
            raise RecordingError("import", str(error)) from error
        record(carla, job, messages)
        messages.send({"kind": "done"})
    except RecordingError as error:
        messages.send({"kind": "failed", "reason": error.kind, "message": str(error)})
        sys.exit(1)
    except RuntimeError as error:  # what carla raises when the server stops answering
        messages.send({"kind": "failed", "reason": "server", "message": str(error)})
        sys.exit(1)


def record(carla, job, messages):
    """Connect, record the frames of one scene, put the server's settings back."""
    client = connect(carla, job, messages)
    world = client.get_world()
    check_alone(world)
    if job.get("restore"):
        return asynchronous(world)
    check_names(carla, client, job)
    client.set_timeout(job["load_s"])
    world = client.load_world(job["town"])
    client.set_timeout(job["timeout_s"])
    settings = world.get_settings()
    manager = client.get_trafficmanager(job["traffic_port"])
    scene = Scene(carla, world, manager, job)
    try:
        scene.begin()
        capture(scene, job, messages)
    finally:
        scene.end()
        settings.synchronous_mode = False
        settings.fixed_delta_seconds = None
        world.apply_settings(settings)


def connect(carla, job, messages):
    """Return the client; tell the recorder the versions."""
    try:
        client = carla.Client(job["host"], job["port"])
        client.set_timeout(job["connect_s"])
        server = client.get_server_version()
    except RuntimeError as error:
        raise RecordingError("nobody", str(error)) from error
    own = client.get_client_version()
    messages.send({"kind": "server", "server": server, "client": own})
    if release(server) != release(own):
        raise RecordingError("version", f"the server is CARLA {server}, this client {own}")
    client.set_timeout(job["timeout_s"])
    return client


def check_names(carla, client, job):
    """Raise RecordingError for a town or a weather that does not exist here."""
    towns = sorted(name.split("/")[-1] for name in client.get_available_maps())
    if job["town"] not in towns:
        raise RecordingError("maps", "there is no map {}; this server has {}".format(job["town"], ", ".join(towns)))
    weathers = sorted(name for name in dir(carla.WeatherParameters) if name[0].isupper())
    if job["weather"] not in weathers:
        raise RecordingError(
            "weather", "there is no weather {}; there are {}".format(job["weather"], ", ".join(weathers))
        )


def release(version):
    """Return a version without what follows its numbers: 0.9.16 of 0.9.16-12-gabc."""
    return version.split("-")[0]


def check_alone(world):
    """Raise RecordingError if another client ticks this server; end the synchronous mode of a killed recorder."""
    if not world.get_settings().synchronous_mode:
        return
    first = world.get_snapshot().frame
    time.sleep(1.0)
    if world.get_snapshot().frame != first:
        raise RecordingError(
            "busy", "another client records from this server: its clock moves while nobody here asks for it"
        )
    asynchronous(world)


def asynchronous(world):
    """Let the server run freely."""
    settings = world.get_settings()
    settings.synchronous_mode = False
    settings.fixed_delta_seconds = None
    world.apply_settings(settings)


class Scene:
    """The ego vehicle with its sensors, traffic and pedestrians, in a world that waits for ticks."""

    def __init__(self, carla, world, manager, job):
        self.carla, self.world, self.manager, self.job = carla, world, manager, job
        self.random = random.Random(job["seed"])
        self.ego = None
        self.sensors, self.walkers, self.controllers, self.vehicles = {}, [], [], []
        self.queues = {}

    def begin(self):
        """Fill the world and switch to ticks."""
        settings = self.world.get_settings()
        settings.synchronous_mode = True
        settings.fixed_delta_seconds = self.job["interval_s"]
        self.world.apply_settings(settings)
        self.world.set_weather(getattr(self.carla.WeatherParameters, self.job["weather"]))
        self.manager.set_synchronous_mode(True)
        self.manager.set_random_device_seed(self.job["seed"])
        self.world.set_pedestrians_seed(self.job["seed"])
        places = list(self.world.get_map().get_spawn_points())
        self.random.shuffle(places)
        self.ego = self._first_vehicle(places)
        self._traffic(places)
        self._pedestrians()
        self._mount()
        self.world.tick()

    def _first_vehicle(self, places):
        blueprint = self.world.get_blueprint_library().find(self.job["ego"])
        blueprint.set_attribute("role_name", "hero")
        while places:
            ego = self.world.try_spawn_actor(blueprint, places.pop())
            if ego is not None:
                ego.set_autopilot(True, self.job["traffic_port"])
                return ego
        raise RecordingError("scene", f"no spawn point of {self.job['town']} is free for the ego vehicle")

    def _traffic(self, places):
        cars = sorted(self.world.get_blueprint_library().filter("vehicle.*"), key=lambda blueprint: blueprint.id)
        for place in places[: self.job["vehicles"]]:
            vehicle = self.world.try_spawn_actor(self.random.choice(cars), place)
            if vehicle is None:
                continue
            vehicle.set_autopilot(True, self.job["traffic_port"])
            if hasattr(self.manager, "update_vehicle_lights"):
                self.manager.update_vehicle_lights(vehicle, True)
            self.vehicles.append(vehicle)

    def _pedestrians(self):
        library = self.world.get_blueprint_library()
        people = sorted(library.filter("walker.pedestrian.*"), key=lambda blueprint: blueprint.id)
        mind = library.find("controller.ai.walker")
        for _ in range(self.job["walkers"]):
            place = self.world.get_random_location_from_navigation()
            if place is None:
                continue
            walker = self.world.try_spawn_actor(self.random.choice(people), self.carla.Transform(place))
            if walker is None:
                continue
            self.walkers.append(walker)
            self.controllers.append(self.world.spawn_actor(mind, self.carla.Transform(), attach_to=walker))
        self.world.tick()
        for walker, controller in zip(self.walkers, self.controllers):
            controller.start()
            controller.go_to_location(self.world.get_random_location_from_navigation())
            controller.set_max_speed(WALKER_SPEED_MPS)
            # since 0.9.15 controllers switch collisions off, and LiDARs don't see what has none
            walker.set_collisions(True)
            walker.set_simulate_physics(True)

    def _mount(self):
        library = self.world.get_blueprint_library()
        for spec in self.job["sensors"]:
            blueprint = library.find(spec["blueprint"])
            for name, value in spec["attributes"].items():
                blueprint.set_attribute(name, str(value))
            x, y, z, pitch, yaw, roll = spec["pose"]
            pose = self.carla.Transform(
                self.carla.Location(x, y, z), self.carla.Rotation(pitch=pitch, yaw=yaw, roll=roll)
            )
            kind = getattr(self.carla.AttachmentType, RIGID)
            sensor = self.world.spawn_actor(blueprint, pose, attach_to=self.ego, attachment_type=kind)
            self.sensors[spec["name"]] = sensor
            self.queues[spec["name"]] = queue.Queue()
            sensor.listen(self.queues[spec["name"]].put)

    def tick(self):
        """Advance by one interval and return the server's snapshot."""
        frame = self.world.tick(self.job["timeout_s"])
        snapshot = self.world.get_snapshot()
        if snapshot.frame != frame:
            raise RecordingError("server", f"the server answered tick {frame} with frame {snapshot.frame}")
        return snapshot

    def data_of(self, frame):
        """Return the data of every sensor at a frame; raise RecordingError for a sensor that sends none."""
        return {name: self._data_of(name, frame) for name in self.queues}

    def _data_of(self, name, frame):
        while True:
            try:
                data = self.queues[name].get(timeout=self.job["timeout_s"])
            except queue.Empty as error:
                waited_s = self.job["timeout_s"]
                raise RecordingError("server", f"sensor {name} sent nothing for {waited_s:g} s") from error
            if data.frame == frame:
                return data
            if data.frame > frame:
                raise RecordingError("server", f"sensor {name} skipped frame {frame} and sent {data.frame}")

    def end(self):
        """Take everything away that was put into the world, sensors first."""
        for sensor in self.sensors.values():
            sensor.stop()
        for controller in self.controllers:
            controller.stop()
        gone = [*self.sensors.values(), *self.controllers, *self.walkers, *self.vehicles]
        for actor in gone + ([] if self.ego is None else [self.ego]):
            actor.destroy()
        self.manager.set_synchronous_mode(False)


def capture(scene, job, messages):
    """Send the frames of a scene, after those in which exposure and traffic settle."""
    places = []
    for index in range(-job["warm_up"], job["frames"]):
        snapshot = scene.tick()
        place = scene.ego.get_transform().location
        places.append((place.x, place.y))
        if index < 0:
            scene.data_of(snapshot.frame)
            messages.send({"kind": "alive"})
            continue
        send_frame(scene, snapshot, index, messages)
        check_moving(places, job)


def check_moving(places, job):
    """Raise RecordingError if the ego has not moved for longer than any traffic light takes."""
    count = int(job["stuck_s"] / job["interval_s"])
    if len(places) <= count:
        return
    (x, y), recent = places[-1], places[-count - 1 :]
    if all(abs(x - a) < STUCK_M and abs(y - b) < STUCK_M for a, b in recent):
        raise RecordingError("stuck", f"the ego vehicle has not moved for {job['stuck_s']:g} s")


def send_frame(scene, snapshot, index, messages):
    """Send what all sensors saw at a tick."""
    found = scene.data_of(snapshot.frame)
    box = scene.ego.bounding_box
    messages.send(
        {
            "kind": "frame",
            "index": index,
            "number": snapshot.frame,
            "time_s": snapshot.timestamp.elapsed_seconds,
            "sensor_times_s": {name: data.timestamp for name, data in found.items()},
            "world_from_vehicle": scene.ego.get_transform().get_matrix(),
            "ego_id": scene.ego.id,
            "ego_box": [vector(box.location), vector(box.extent)],
            "actors": [facts(actor, "vehicle") for actor in scene.vehicles]
            + [facts(actor, "walker") for actor in scene.walkers],
            "matrices": {name: data.transform.get_matrix() for name, data in found.items()},
        },
        [(name, bytes(data.raw_data)) for name, data in found.items()],
    )


def facts(actor, kind):
    """Return what the recorder needs to know of an actor, in Unreal's frames."""
    box = actor.bounding_box
    return {
        "id": actor.id,
        "kind": kind,
        "matrix": actor.get_transform().get_matrix(),
        "center": vector(box.location),
        "extent": vector(box.extent),
        "velocity": vector(actor.get_velocity()),
    }


def vector(value):
    """Return x, y, z of a carla vector."""
    return [value.x, value.y, value.z]


def _leave(number, frame):
    raise SystemExit(128 + number)


if __name__ == "__main__":
    main()
