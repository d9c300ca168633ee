"""Cost of one frame of the virtual world by stage, in CPU seconds: `python tests/bench/bench_world.py [frames]`.

One thread, mean over frames 0.5 s apart (five times the paper's interval, so that more sweeps of standing LiDARs begin
than in the paper's dataset), all eight themes at 512x288 and one at the size of `preset=tiny`. 'floor' is what the rays
alone would cost: their number over the rate at which Embree casts one camera's rays into what is static here.
"""

import cProfile
import pstats
import sys
import time
from itertools import pairwise

import numpy as np
import torch

from omniocc.camera import Rig
from omniocc.data.store.codec import encode_frame
from omniocc.geometry import Cuboid, Cylinder
from omniworld import THEMES, Frame, Scene
from omniworld.render.capture import expose
from omniworld.render.caster import Caster
from omniworld.render.snapshot import Snapshot

INTERVAL_S = 0.5
GRIDS = (Cylinder((128, 200, 16)), Cuboid((256, 256, 16)))
PROCESSES = 2


def rates(scene: Scene, snapshot: Snapshot) -> tuple[float, float]:
    """Rays per second of the front camera against all that is static: to the nearest hit, and to any hit."""
    view, static = scene.recorder.views[0], snapshot.layers.casters[0]
    directions = np.ascontiguousarray(snapshot.world_directions(view.center).T)
    origin = snapshot.world_point(view.origin_m)[None]
    found = []
    for work in (static.cast, static.blocked):
        times = []
        origins = origin if work == static.cast else np.repeat(origin, len(directions), axis=0)
        for _ in range(5):
            start = time.process_time()
            work(origins, directions)
            times.append(time.process_time() - start)
        found.append(len(directions) / min(times))
    return found[0], found[1]


class RayCounter:
    """Counts the rays cast against static things while it is in use."""

    def __init__(self, static: Caster) -> None:
        self.nearest = self.any = 0
        self._static = static
        self._cast, self._blocked = Caster.cast, Caster.blocked

    def __enter__(self) -> "RayCounter":
        def cast(caster, origins, directions, *rest):
            self.nearest += len(directions) * (caster is self._static)
            return self._cast(caster, origins, directions, *rest)

        def blocked(caster, origins, *rest):
            self.any += len(origins) * (caster is self._static)
            return self._blocked(caster, origins, *rest)

        Caster.cast, Caster.blocked = cast, blocked
        return self

    def __exit__(self, *_: object) -> None:
        Caster.cast, Caster.blocked = self._cast, self._blocked


def stages_of(scene: Scene, index: int) -> dict[str, float]:
    """CPU seconds of each stage of one frame."""
    marks = [("", time.process_time())]

    def mark(name: str) -> None:
        marks.append((name, time.process_time()))

    time_s = index * INTERVAL_S
    snapshot, _ = scene.snapshot(time_s)
    mark("moving things")
    rendered = [see(snapshot) for see in scene.recorder.renderers]
    mark("cameras: rays and shading")
    for view, seen in zip(scene.recorder.views, rendered, strict=True):
        expose(view, seen, snapshot.light, scene.sensor, np.random.default_rng(index))
    mark("cameras: exposure")
    scene.recorder.labeller.scan(snapshot)
    mark("semantic LiDARs, thinning")
    scene.recorder.ranges(snapshot)
    mark("panorama, ego LiDAR")
    return {name: end - start for (_, start), (name, end) in pairwise(marks)}


def voxelize(frame: Frame) -> None:
    """Both grids of the paper."""
    points, labels = torch.from_numpy(frame.points_m), torch.from_numpy(frame.point_labels)
    for grid in GRIDS:
        grid.voxelize(points, labels)


def report(theme: str, size: tuple[int, int], frames: int) -> float:
    """Prints one block; CPU seconds of a frame in all."""
    start = time.process_time()
    scene = Scene(theme, 1, Rig.load("fisheye6").resized(*size), frame_interval_s=INTERVAL_S)
    built = time.process_time() - start
    scene.frame(0)
    static = scene.snapshot(0.0)[0].layers.casters[0]
    with RayCounter(static) as counter:
        spent = [stages_of(scene, index) for index in range(1, frames + 1)]
    nearest, anything = (count / frames for count in (counter.nearest, counter.any))
    cast_rate, blocked_rate = rates(scene, scene.snapshot(0.0)[0])
    frame = scene.frame(frames)
    start = time.process_time()
    for _ in range(3):
        blobs = encode_frame(frame)
    encoded = (time.process_time() - start) / 3
    voxelize(frame)  # what a grid works out once
    start = time.process_time()
    for _ in range(3):
        voxelize(frame)
    voxels = (time.process_time() - start) / 3
    total = sum(sum(one.values()) for one in spent) / frames + encoded + voxels
    print(f"{theme} {size[0]}x{size[1]}: {total:.3f} CPU-s a frame, scene built in {built:.2f}")
    for name in spent[0]:
        print(f"  {name:28} {np.mean([one[name] for one in spent]):.3f}")
    print(f"  {'encoding':28} {encoded:.3f}   {sum(map(len, blobs.values())) / 1e6:.2f} MB")
    print(f"  {'voxels of both paper grids':28} {voxels:.3f}")
    print(
        f"  floor {nearest / cast_rate + anything / blocked_rate:.3f}: {nearest / 1e6:.2f} M rays to their hits at "
        f"{cast_rate / 1e6:.1f} Mray/s, {anything / 1e6:.2f} M to the light at {blocked_rate / 1e6:.1f} Mray/s"
    )
    return total


def hot_spots(theme: str, frames: int) -> None:
    """Prints the functions that take most."""
    scene = Scene(theme, 1, Rig.load("fisheye6").resized(512, 288), frame_interval_s=INTERVAL_S)
    scene.frame(0)
    profile = cProfile.Profile(time.process_time)
    profile.enable()
    for index in range(1, frames + 1):
        scene.frame(index)
    profile.disable()
    pstats.Stats(profile).sort_stats("tottime").print_stats(12)


def main() -> None:
    """Prints one block per theme, their mean, and a profile."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    torch.set_num_threads(1)
    report("downtown", (256, 144), frames)
    mean = float(np.mean([report(theme, (512, 288), frames) for theme in THEMES]))
    print(f"mean of {len(THEMES)} themes at 512x288: {mean:.3f} CPU-s a frame, {PROCESSES / mean:.2f} frames/s", end="")
    print(f" with {PROCESSES} processes on as many cores")
    hot_spots("downtown", frames)


if __name__ == "__main__":
    main()
