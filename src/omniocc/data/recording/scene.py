"""What every recorder writes into a scene: frames one by one, then the calibration and the facts."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from omniocc.camera import Rig
from omniocc.data.recording.spec import plain_spec
from omniocc.data.source import SourceSpec
from omniocc.data.store.codec import encode_frame
from omniocc.data.store.frame import RecordedFrame
from omniocc.data.store.shard import SceneWriter
from omniocc.frame import Frame

SOFTWARE = ("numpy", "opencv-python-headless", "zstandard")
"""Packages whose versions are written beside the frames."""


def append_frame(writer: SceneWriter, frame: Frame | RecordedFrame) -> None:
    """Write a frame, with its time and pose in the index."""
    entry = {"time_s": float(frame.time_s), "world_from_ego": frame.world_from_ego.tolist()}
    writer.append(encode_frame(frame), entry)


def finish_scene(
    writer: SceneWriter,
    rig: Rig,
    spec: SourceSpec,
    edges_deg: tuple[float, float],
    facts: Mapping[str, Any],
    software: Sequence[str] = SOFTWARE,
) -> None:
    """Write the calibration, the facts about the scene and the versions of packages, and complete the scene.

    `edges_deg` are the elevations of the upper and lower edge of its panoramas of ranges.
    """
    writer.attach("rig.yaml", rig.save)
    versions = {name: version(name) for name in software}
    writer.finish({**facts, "panorama_edges_deg": list(edges_deg), "spec": plain_spec(spec), "software": versions})
