"""Rendering of planned scenes, each into a folder of its own."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from omniocc.data.recording.pool import Report, Stopped
from omniocc.data.recording.scene import SOFTWARE, append_frame, finish_scene
from omniocc.data.source import Split
from omniocc.data.store.shard import SceneWriter
from omniocc.errors import DataError
from omniocc.world import Frame

if TYPE_CHECKING:
    from omniocc.data.source.virtual import VirtualWorld


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


def record_scene(world: "VirtualWorld", folder: Path, report: Report) -> None:
    """Render the frames that are missing in the folder of a planned scene, then complete it.

    Raises:
        RuntimeError: naming scene and frame, when the world fails.
    """
    with closing(SceneWriter(folder, world.shard_limit_bytes)) as writer:
        if writer.finished:
            report(world.frames_per_scene)
            return
        report(writer.num_frames)
        plan = next(plan for plan in world.plans if plan.name == folder.name)
        _record_frames(world, plan, writer, report)
        facts = {"split": plan.split, "theme": plan.theme, "seed": plan.seed, "weather": world.weather_of(plan)}
        facts["recipe"] = world.recipe
        edges_deg = world.erp_top_deg, world.erp_bottom_deg
        finish_scene(writer, world.calibration_of(plan), world.spec, edges_deg, facts, (*SOFTWARE, "embreex"))


def _record_frames(world: "VirtualWorld", plan: ScenePlan, writer: SceneWriter, report: Report) -> None:
    index = writer.num_frames
    try:
        scene = world.scene(plan) if index < world.frames_per_scene else None
        for index in range(writer.num_frames, world.frames_per_scene):
            assert scene is not None
            append_frame(writer, scene.frame(index))
            report(1)
    except (DataError, Stopped):
        raise
    except Exception as error:  # of any kind: the message names scene and frame
        raise RuntimeError(f"scene {plan.name}, frame {index}: {type(error).__name__}: {error}") from error
