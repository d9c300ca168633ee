"""Rendering of planned scenes, each into a folder of its own."""

import ast
import functools
import hashlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from omniocc.camera import Rig
from omniocc.data.recording.pool import Report, Stopped
from omniocc.data.recording.spec import plain_spec
from omniocc.data.source import SourceSpec, Split
from omniocc.data.store.codec import encode_frame
from omniocc.data.store.shard import SceneWriter
from omniocc.errors import DataError
from omniocc.world import Frame, seeding
from omniocc.world.render.weather import draw_weather

RECORDERS = ("numpy", "opencv-python-headless", "zstandard", "embreex")
"""Packages whose versions are written beside the frames."""
"""Packages whose versions are written beside the frames."""


class ScenePlan(NamedTuple):
    """A scene that is to be rendered: its name, split, kind of place, and the seed of everything random in it."""

    name: str
    split: Split
    theme: str
    seed: int


@runtime_checkable
class Recordable(Protocol):
    """A scene that can be recorded frame by frame, such as `omniocc.world.Scene`."""

    def frame(self, index: int) -> Frame:
        """Return the frame with this number; it depends on nothing but the scene and the number."""
        ...


@functools.cache
def code_fingerprint(folder: Path) -> str:
    """Return a hash of the code in a folder and its subfolders, without comments, docstrings and layout."""
    digest = hashlib.sha256()
    modules = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.py")}
    for name, path in sorted(modules.items()):
        if "__pycache__" in name.split("/"):
            continue
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            first = body[0] if isinstance(body, list) and body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                first.value.value = ""
        digest.update(f"{name}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class SceneJob:
    """Renders one scene folder after another; can be sent to other processes.

    Attributes:
        build: makes the world of a planned scene.
        plans: all scenes that may have to be rendered.
        recipe: everything that decides the content of frames; written beside them.
        spec: facts about all scenes; written beside the frames.
        rig: the cameras; written beside the frames.
    """

    build: Callable[[ScenePlan], Recordable]
    plans: tuple[ScenePlan, ...]
    recipe: dict[str, Any]
    spec: SourceSpec
    rig: Rig
    frames: int
    shard_limit_bytes: int

    def __call__(self, folder: Path, report: Report) -> None:
        """Render the frames of `folder` that are missing, then complete it.

        Raises:
            RuntimeError: naming scene and frame, when the world fails.
        """
        with closing(SceneWriter(folder, self.shard_limit_bytes)) as writer:
            if writer.finished:
                report(self.frames)
            else:
                self._record(writer, next(plan for plan in self.plans if plan.name == folder.name), report)

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
        except Exception as error:  # of any kind: the message names scene and frame
            raise RuntimeError(f"scene {plan.name}, frame {index}: {type(error).__name__}: {error}") from error
        writer.attach("rig.yaml", self.rig.save)
        weather = self.recipe["weather"] or weather_of(plan.theme, plan.seed)
        facts = {"split": plan.split, "theme": plan.theme, "seed": plan.seed, "weather": weather, "recipe": self.recipe}
        software = {name: version(name) for name in RECORDERS}
        writer.finish(facts | {"spec": plain_spec(self.spec), "software": software})


def weather_of(theme: str, seed: int) -> str:
    """Return the weather that `omniocc.world.Scene` draws for a scene when none is chosen."""
    return draw_weather(seeding.generator(theme, seed, "light"))
