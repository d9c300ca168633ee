"""Contents of `meta.json` and of the index of a recorded scene: its spec, facts, times and poses."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.pose import check_road
from omniocc.camera.protocol import finite, numbers, positive
from omniocc.classes import ClassTable
from omniocc.data.source import SourceSpec
from omniocc.data.store.codec import encode_frame
from omniocc.data.store.frame import RecordedFrame
from omniocc.data.store.shard import SceneWriter
from omniocc.frame import Frame
from rayiou.cylinder import PAPER_RANGE_EDGES_M
from rayiou.directions import sparseocc_directions

DRAWN_RIGS = ("random", "any")
"""Values of `rig` in the recipe of scenes that each have another, drawn rig."""
ORIGIN = "origin_above_road_m"
"""Key of a recipe that sets the height of the ego origin above the road."""
RENDERED_REACH_M = (26.0, 26.0, 6.0)
"""Points of rendered scenes end at these distances from the ego origin along x, y and z."""
MAX_EDGES = 100
"""Largest number of edges of distance bands that a spec may have."""

SOFTWARE = ("numpy", "opencv-python-headless", "zstandard")
"""Packages whose versions are written beside the frames."""


def recorded_spec(classes: ClassTable, frame_interval_s: float, road_z_m: float | None) -> SourceSpec:
    """Return the spec of recorded scenes, with the paper's distance bands and the LiDAR rays of SparseOcc."""
    return SourceSpec(classes, PAPER_RANGE_EDGES_M, frame_interval_s, road_z_m, sparseocc_directions())


def panorama_of(given: Sequence[float]) -> Equirectangular:
    """Return the panorama of four numbers: width and height (px), elevations of upper and lower edge (deg).

    Raises:
        ValueError: if there are not four, or they make no panorama.
    """
    if len(given) != 4:
        raise ValueError(f"panorama is {list(given)}; give width and height, px, upper and lower edge, deg")
    width, height, top_deg, bottom_deg = given
    return Equirectangular(int(width), int(height), float(top_deg), float(bottom_deg))


def plain_spec(spec: SourceSpec) -> dict[str, Any]:
    """Return a spec as plain data; the LiDAR's rays are left out, since the format fixes them."""
    return {
        "classes": spec.classes.to_dict(),
        "range_edges_m": list(spec.range_edges_m),
        "frame_interval_s": spec.frame_interval_s,
        "road_z_m": spec.road_z_m,
    }


def read_spec(plain: dict[str, Any]) -> SourceSpec:
    """Return the spec of recorded scenes, the inverse of `plain_spec`.

    Raises:
        Exception: one of `omniocc.errors.FAULTS`, if something is missing or makes no sense.
    """
    if (edges_m := numbers("range_edges_m", plain["range_edges_m"], 2, MAX_EDGES))[0] < 0:
        raise ValueError(f"range_edges_m begin at {edges_m[0]:g} m; ranges are 0 or more")
    positive("frame_interval_s", plain["frame_interval_s"])
    check_road(None if plain["road_z_m"] is None else finite("road_z_m", plain["road_z_m"]))
    return SourceSpec(
        classes=ClassTable.from_dict(plain["classes"]),
        range_edges_m=tuple(plain["range_edges_m"]),
        frame_interval_s=plain["frame_interval_s"],
        road_z_m=plain["road_z_m"],
        lidar_directions=sparseocc_directions(),
    )


def append_frame(writer: SceneWriter, frame: Frame | RecordedFrame) -> None:
    """Append a frame to the scene, and its time and pose to the index."""
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
    """Write the calibration, the facts about the scene and the versions of `software`; mark the scene as complete.

    `edges_deg` are the elevations of the upper and lower edge of its panoramas of ranges.
    """
    writer.attach("rig.yaml", rig.save)
    versions = {name: version(name) for name in software}
    writer.finish({**facts, "panorama_edges_deg": list(edges_deg), "spec": plain_spec(spec), "software": versions})
