"""Cost of one frame of the virtual world by stage, in CPU seconds: `python tests/bench/bench_world.py [frames]`.

One thread, mean over frames 0.5 s apart, at the sizes of `preset=tiny` and at 512x288. 'floor' is what the rays alone
would cost: their number over the rate at which Embree, called once with one camera's rays, casts them into this place.
"""

import cProfile
import pstats
import sys
import time
from itertools import pairwise

import numpy as np

from omniocc.camera import Rig
from omniocc.data.codec import encode_frame
from omniocc.world import Scene
from omniocc.world.capture import expose
from omniocc.world.caster import Caster
from omniocc.world.stage import Stage, repeat

INTERVAL_S = 0.5


def embree_rate(scene: Scene, stage: Stage) -> float:
    """Rays per second of the front camera against all that is static."""
    view = scene.recorder.views[0]
    directions = np.ascontiguousarray(stage.turn(view.center).T)
    origins = repeat(stage.place(view.origin_m), len(directions))
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        stage.layers.casters[0].cast(origins, directions)
        best = min(best, time.process_time() - start)
    return len(directions) / best


class RayCounter:
    """Counts the rays that are cast while it is in use."""

    def __init__(self) -> None:
        self.rays = 0
        self._cast, self._blocked = Caster.cast, Caster.blocked

    def __enter__(self) -> "RayCounter":
        def cast(caster, origins, *rest):
            self.rays += len(origins) * (caster.size > 0)
            return self._cast(caster, origins, *rest)

        def blocked(caster, origins, *rest):
            self.rays += len(origins) * (caster.size > 0)
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
    stage, _ = scene.stage(time_s)
    mark("moving things")
    looks = [see(stage) for see in scene.recorder.looks]
    mark("cameras: rays and shading")
    for view, seen in zip(scene.recorder.views, looks, strict=True):
        expose(view, seen, stage.light, scene.sensor, np.random.default_rng(index))
    mark("cameras: exposure")
    scene.recorder.labeller.scan(stage)
    mark("semantic LiDARs, thinning")
    scene.recorder.ranges(stage)
    mark("panorama, ego LiDAR")
    return {name: end - start for (_, start), (name, end) in pairwise(marks)}


def report(theme: str, size: tuple[int, int], frames: int) -> None:
    """Prints one block."""
    start = time.process_time()
    scene = Scene(theme, 1, Rig.load("fisheye6").resized(*size), frame_interval_s=INTERVAL_S)
    built = time.process_time() - start
    scene.frame(0)
    with RayCounter() as counter:
        spent = [stages_of(scene, index) for index in range(1, frames + 1)]
    rays, rate = counter.rays / frames, embree_rate(scene, scene.stage(0.0)[0])
    start = time.process_time()
    blobs = encode_frame(scene.frame(frames))
    encoded = time.process_time() - start
    start = time.process_time()
    scene.frame(frames)
    encoded -= time.process_time() - start
    total = sum(sum(one.values()) for one in spent) / frames
    print(f"{theme} {size[0]}x{size[1]}: {total + encoded:.3f} CPU-s a frame, scene built in {built:.2f}")
    for name in spent[0]:
        print(f"  {name:28} {np.mean([one[name] for one in spent]):.3f}")
    print(f"  {'encoding':28} {encoded:.3f}   {sum(map(len, blobs.values())) / 1e6:.2f} MB")
    print(f"  floor {rays / rate:.3f}: {rays / 1e6:.2f} M rays at {rate / 1e6:.1f} Mray/s")


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
    """Prints one block per theme and size, then a profile."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    for size in ((256, 144), (512, 288)):
        for theme in ("downtown", "suburb"):
            report(theme, size, frames)
    hot_spots("suburb", frames)


if __name__ == "__main__":
    main()
