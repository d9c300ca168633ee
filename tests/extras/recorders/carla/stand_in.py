"""A stand-in for a CARLA server and the part of its client that `client.py` uses, driven by the virtual world.

`python stand_in.py client.py` runs a script to which `import carla` gives this stand-in. Transforms, rotations,
weathers and attachments are those of the real client, whose own `get_matrix` places everything, so that our conversion
between left- and right-handed frames is compared with CARLA's. The environment variable STAND_IN holds options as JSON:

    theme, seed, rig     of the virtual scene
    state                file that keeps the server's settings between clients
    version              that the server says
    tags                 numbers by our class names that the server uses
    nobody               true: no server answers
    fault, at            what happens at a tick: crash (the process dies), hang (no answer), late (a sensor skips)
    once                 file that makes faults happen only while it does not exist
    still                true: the ego never moves
    depth_scale, mirror  lies about depth, and about the side on which sensors are mounted
"""

import json
import os
import runpy
import sys
import types
from pathlib import Path

import carla as real

OPTIONS = {"theme": "downtown", "seed": 3, "rig": "fisheye6", "version": "0.9.16", "tags": None, "nobody": False}
OPTIONS |= {"fault": None, "at": 0, "once": None, "still": False, "depth_scale": 1.0, "mirror": False, "state": None}


def options():
    return OPTIONS | json.loads(os.environ.get("STAND_IN", "{}"))


class Settings:
    def __init__(self, synchronous_mode=False, fixed_delta_seconds=None):
        self.synchronous_mode, self.fixed_delta_seconds = synchronous_mode, fixed_delta_seconds


class Idle:
    """The server before a town is loaded, when it knows its settings and the time alone."""

    def __init__(self):
        self.frame, self.time_s, self.ticks = 1000, 50.0, 0
        state = options()["state"]
        self.settings_file = None if state is None else Path(state)

    def get_settings(self):
        if self.settings_file is None or not self.settings_file.exists():
            return Settings()
        return Settings(**json.loads(self.settings_file.read_text()))

    def apply_settings(self, settings):
        if self.settings_file is not None:
            self.settings_file.write_text(json.dumps(vars(settings)))

    def get_snapshot(self):
        stamp = types.SimpleNamespace(elapsed_seconds=self.time_s)
        return types.SimpleNamespace(frame=self.frame, timestamp=stamp)


class Manager:
    def set_synchronous_mode(self, on):
        pass

    def set_random_device_seed(self, seed):
        assert isinstance(seed, int)


class Client:
    def __init__(self, host, port):
        self.world = Idle()

    def set_timeout(self, seconds):
        assert seconds > 0

    def get_server_version(self):
        if options()["nobody"]:
            raise RuntimeError("time-out of 2000ms while waiting for the simulator")
        return options()["version"]

    def get_client_version(self):
        return "0.9.16"

    def get_world(self):
        return self.world

    def get_available_maps(self):
        return [f"/Game/Carla/Maps/{town}" for town in ("Town01", "Town02", "Town03", "Town10HD")]

    def load_world(self, town):
        assert f"/Game/Carla/Maps/{town}" in self.get_available_maps()
        from stand_in_world import World  # seconds of imports, which a server that is refused does without

        self.world = World()
        return self.world

    def get_trafficmanager(self, port):
        return Manager()


def install():
    """Give `import carla` this stand-in, with the real client's plain classes."""
    module = types.ModuleType("carla")
    for name in ("Transform", "Location", "Rotation", "WeatherParameters", "AttachmentType", "BoundingBox", "Vector3D"):
        setattr(module, name, getattr(real, name))
    module.Client = Client
    sys.modules["carla"] = module


if __name__ == "__main__":
    install()
    sys.argv = sys.argv[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")
