"""The views that a viewer opens with: truth beside each model, images, ranges and the curve of RayIoU."""

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from omniocc.extras.viewer.frames import ShownFrame
from omniocc.extras.viewer.timeline import paths

EVERYWHERE = (paths.CAMERAS, paths.TRAJECTORY)
"""What is drawn in every view of the space around the car."""
EYE_M, TARGET_M = (-28.0, 0.0, 22.0), (0.5, 0.0, -3.0)
"""Where the eye begins, and what it looks at, m, ego frame: as in the sheets."""
MODEL_PARTS = {
    "prediction": paths.VOXELS,
    "differences": paths.DIFFERENCES,
    "rays": paths.RAYS,
    "candidates": paths.CANDIDATES,
    "ranges": paths.POINTS,
}
"""Views of a model, one of which is in front."""


def layout(frame: ShownFrame, ranges: Sequence[str] = ()) -> rrb.Blueprint:
    """Return views for what a frame holds, and for further ranges; the same serve the frames after it."""
    names = [paths.model_name(name) for name in frame.predictions]
    truth = [_space(paths.truth_name(grid), [*paths.VOXELS, paths.truth_name(grid)]) for grid in frame.truth]
    if frame.lidar is not None:
        truth.append(_space("LiDAR", paths.LIDAR))
    if frame.range_m is not None:
        truth.append(_space("true ranges", [*paths.POINTS, paths.TRUTH]))
    truth += [_space(f"ranges: {name}", [*paths.POINTS, name]) for name in ranges]
    columns = [rrb.Tabs(*truth, name="truth")] if truth else []
    columns += [
        rrb.Tabs(*[_space(f"{name}: {part}", [*path, name]) for part, path in MODEL_PARTS.items()]) for name in names
    ]
    below = [*_images(frame, names), *_ranges(frame, ranges)]
    if names:
        below.append(rrb.TimeSeriesView(origin=_text([*paths.FIGURES, "rayiou"]), name="RayIoU of each frame"))
    below.append(rrb.TextDocumentView(origin=_text(paths.DESCRIPTION), name="frame"))
    rows = [rrb.Horizontal(*columns), rrb.Horizontal(*below)]
    panels = [
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(timeline="frame", state="expanded"),
    ]
    return rrb.Blueprint(rrb.Vertical(*rows, row_shares=[3, 2]), *panels)


def _images(frame: ShownFrame, models: Sequence[str]) -> list[rrb.Tabs]:
    """Return the cameras' images, plain and behind the classes of the pixels by each model."""
    if not frame.images:
        return []
    cameras = frame.rig.names if frame.rig is not None else [f"{k}" for k in range(len(frame.images))]

    def grid(title: str, model: str | None) -> rrb.Grid:
        views = []
        for camera in cameras:
            origin = [*paths.IMAGES, camera]
            contents = [_text(origin)] if model is None else [_text(origin), _text([*origin, model])]
            views.append(rrb.Spatial2DView(origin=_text(origin), contents=contents, name=camera))
        return rrb.Grid(*views, grid_columns=3, name=title)

    seen = [paths.model_name(name) for name, one in frame.predictions.items() if one.pixel_labels is not None]
    classes = [grid(f"{name}: classes of pixels", name) for name in models if name in seen]
    return [rrb.Tabs(grid("images", None), *classes)]


def _ranges(frame: ShownFrame, others: Sequence[str]) -> list[rrb.Vertical]:
    known = [*others]
    known += [] if frame.range_m is None else [paths.TRUTH]
    known += [paths.model_name(name) for name, one in frame.predictions.items() if one.range_m is not None]
    views = [rrb.Spatial2DView(origin=_text([*paths.RANGES, name]), name=f"ranges: {name}") for name in known]
    return [rrb.Vertical(*views, name="ranges")] if views else []


def _space(title: str, path: Sequence[str]) -> rrb.Spatial3DView:
    contents = [f"+ {_text(part)}/**" for part in (path, *EVERYWHERE)]
    eye = rrb.EyeControls3D(position=EYE_M, look_target=TARGET_M, eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(origin=_text(paths.EGO), contents=contents, name=title, eye_controls=eye)


def _text(parts: Sequence[str]) -> str:
    return rr.new_entity_path(list(parts))
