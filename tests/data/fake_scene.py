"""A cheap substitute for the virtual world, importable by render processes: frames from a seeded generator."""

import os
import time
from collections.abc import Sequence

import numpy as np

from omniocc.frame import Box, Frame
from omniworld.plans import ScenePlan
from omniworld.source import VirtualWorld

CAMERAS, WIDTH, HEIGHT = 6, 32, 18
RAYS = 14040
"""Of the LiDAR, which the format fixes."""


def fake_frame(seed: int, index: int, interval_s: float = 0.5) -> Frame:
    rng = np.random.default_rng([seed, index])
    range_m = rng.uniform(0.5, 60, (CAMERAS, HEIGHT, WIDTH)).astype(np.float32)
    range_m[:, 0], range_m[:, -1] = np.inf, np.nan
    pose = np.eye(4)
    pose[0, 3] = 3.0 * index
    points = 500
    return Frame(
        time_s=index * interval_s,
        world_from_ego=pose,
        images=rng.integers(0, 256, (CAMERAS, HEIGHT, WIDTH, 3), dtype=np.uint8),
        semantics=rng.integers(0, 12, (CAMERAS, HEIGHT, WIDTH), dtype=np.uint8),
        range_m=range_m,
        erp_range_m=rng.uniform(0.5, 60, (8, 16)).astype(np.float32),
        points_m=rng.uniform([-20, -20, -2.5], [20, 20, 3], (points, 3)).astype(np.float32),
        point_labels=rng.integers(1, 12, points).astype(np.uint8),
        lidar_range_m=np.append(rng.uniform(1, 50, RAYS - 1), np.inf).astype(np.float32),
        lidar_labels=np.append(rng.integers(1, 12, RAYS - 1), 0).astype(np.uint8),
        boxes=(Box(7, 7, (1.0, 2.5, -1.1), (4.5, 1.9, 1.5), 0.3, (8.25, -0.1)),),
    )


class FakeScene:
    def __init__(self, plan: ScenePlan, delay_s: float, fail_at: tuple[str, int] | None):
        self.plan, self.delay_s, self.fail_at = plan, delay_s, fail_at

    def frame(self, index: int) -> Frame:
        if self.fail_at == (self.plan.name, index):
            raise ZeroDivisionError("no such street")
        time.sleep(self.delay_s)
        if mark := os.environ.get("FAKE_SCENE_MARK"):
            with open(mark, "a", encoding="utf-8") as file:
                file.write(f"{self.plan.name} {index}\n")
        return fake_frame(self.plan.seed, index)


class FakeWorld(VirtualWorld):
    """`VirtualWorld` with random frames instead of rendered ones."""

    def __init__(
        self,
        root: str,
        scenes: Sequence[int] = (2, 1, 1),
        frames: int = 4,
        workers: int = 0,
        delay_s: float = 0.0,
        fail_at: tuple[str, int] | None = None,
        seed: int = 0,
        cache: str | None = None,
    ):
        super().__init__(
            root=str(root),
            rig="fisheye6",
            image_size=(WIDTH, HEIGHT),
            themes=("downtown", "suburb"),
            train_scenes=scenes[0],
            val_scenes=scenes[1],
            test_scenes=scenes[2],
            frames_per_scene=frames,
            frame_interval_s=0.5,
            supersample=1,
            erp_size=(16, 8),
            erp_top_deg=45.0,
            erp_bottom_deg=-45.0,
            seed=seed,
            workers=workers,
            cache=cache,
        )
        self.shard_limit_bytes = 120_000
        self.delay_s, self.fail_at = delay_s, fail_at

    def scene(self, plan: ScenePlan) -> FakeScene:
        return FakeScene(plan, self.delay_s, self.fail_at)
