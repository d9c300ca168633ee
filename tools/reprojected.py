"""Score a checkpoint with ranges from the rig's centre, re-projected to the ego origin: `python tools/reprojected.py any-rig`.

The scenes are the validation scenes of the checkpoint's data; missing ones are rendered. Frames are predicted with the
history that `predict.py occupancy` gives them, and cells are occupied as the checkpoint says. The standard errors are
those of the gain over the ranges as they are, by the jackknife over scenes.
"""

import argparse
from copy import deepcopy
from functools import partial
from typing import cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.geometry import Grid
from omniocc.model.depth import DepthMap
from omniocc.model.depth.mono import draw_front, fill_holes
from omniocc.model.ops.depth.depth_map import from_index
from omniocc.predict import load
from omniocc.predict.input.sequence import RecordedSequence
from omniocc.predict.options import choose_device
from omniocc.predict.predictor import Predictor
from omniocc.predict.road import LIKE_ROAD, WITHIN, flat_road_m, on_road
from omniocc.progress import Progress
from omniocc.runs.robustness import jackknife_error
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries
from omniocc.runs.table import in_columns
from omniocc.train.scores import Scores

KEYS = ("rayiou", "lidar/rayiou", "voxel/iou", "rayiou/Road", "rayiou/Building", "rayiou/Vegetation", "rayiou/Vehicle")


def reproject(depth: DepthMap, panorama: Equirectangular, shift_m: Float[Tensor, "3"], spheres, passes: int) -> DepthMap:
    """Return ranges around an origin that lies at -shift_m in the frame of the given ones, in the same orientation.

    Args:
        shift_m: position of the old origin in the new frame.
        passes: how often holes are filled from their neighbours; see `fill_holes`.
    """
    points_m = depth.range_m[..., None] * panorama.rays().to(depth.range_m) + shift_m.to(depth.range_m)
    range_m, confidence = draw_front(points_m.flatten(1, 2), depth.confidence.flatten(1), depth.valid.flatten(1), panorama)
    filled = fill_holes(range_m, passes)
    valid = filled.isfinite()
    index = spheres.index(torch.where(valid, filled, spheres.farthest_m))
    return from_index(index, valid, confidence, spheres)


class Moved(nn.Module):
    """A depth network whose ranges are computed around the mean height of the cameras where `mix` wants them."""

    def __init__(self, depth: nn.Module, passes: int, mix: str):
        super().__init__()
        self.depth, self.passes, self.mix = depth, passes, mix

    def __getattr__(self, name: str):
        try:
            return super().__getattr__(name)
        except AttributeError:
            return getattr(super().__getattr__("depth"), name)

    def forward(self, images: Tensor, rigs: tuple[Rig, ...], true_range_m: Tensor | None = None) -> DepthMap:
        (rig,) = rigs
        if self.mix.startswith("direct"):
            direct = self.depth(images, rigs, true_range_m)
            return on_road(direct, self.depth, rig, WITHIN) if self.mix == "direct, on road" else direct
        panorama = cast(Equirectangular, self.depth.panorama)
        height_m = float(rig.ego_from_camera[:, 2, 3].mean())
        low = rig.raised(height_m)
        centred = self.depth(images, (low,), None)
        if self.mix.endswith("on road"):
            centred = on_road(centred, self.depth, low, WITHIN)
        moved = reproject(centred, panorama, torch.tensor([0, 0, height_m]), self.depth.rig_spheres(rig), self.passes)
        if self.mix.startswith("all"):
            return moved
        direct = self.depth(images, rigs, true_range_m)
        flat_m = flat_road_m(panorama, cast(float, rig.road_z_m))
        use = flat_m.isfinite() & direct.valid
        if self.mix == "standing":
            use = use & ((direct.range_m / flat_m - 1).abs() < LIKE_ROAD)
        use = use | ~moved.valid
        return DepthMap(*(torch.where(use, ours, theirs) for ours, theirs in zip(direct, moved, strict=True)))


VARIANTS = {
    "direct": (0, "direct"),
    "direct, on road": (0, "direct, on road"),
    "re-projected": (0, "all"),
    "re-projected, 2 passes": (2, "all"),
    "re-projected, 6 passes": (6, "all"),
    "re-projected, on road, 6 passes": (6, "all, on road"),
    "above the horizon": (6, "above"),
    "what stands": (6, "standing"),
}


def merged(parts: list[Scores]) -> dict[str, float]:
    """Return the figures of some scenes."""
    total = deepcopy(parts[0])
    for part in parts[1:]:
        total.merge(part)
    return {key: float(value) for key, value in total.compute().items() if key in KEYS}


@lines_not_tracebacks
def main(words: list[str] | None = None) -> None:
    """Print a table with a row for each way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, folder of a run, or name of shipped weights")
    parser.add_argument("overrides", nargs="*", help="changes of its configuration, such as data.source.val_scenes=8")
    given = parser.parse_args(words)
    quiet_libraries()
    trained = load(given.checkpoint, given.overrides)
    source, model = trained.data.source, trained.occupancy
    scenes = source.made("val", list(source.planned("val")))  # type: ignore[attr-defined]
    new = partial(Scores, cast(Grid, model.geometry), trained.data.spec)
    depth, device = model.sketch.depth, choose_device(None)
    rows, first = [], {}
    for name, (passes, mix) in VARIANTS.items():
        model.sketch.depth = Moved(depth, passes, mix)
        predictor, parts = Predictor(model, None, (), device, trained.occupied_above), []
        with Progress(f"predicting: {name}", sum(map(len, scenes))) as progress:
            for scene in scenes:
                parts.append(new())
                sequence = RecordedSequence(scene, tuple(range(len(scene))))
                predictor.image_width = trained.facts.width_for(sequence.rig)
                history = "stream" if model.temporal.frames > 1 else "none"
                for frame, _, found, _ in predictor.frames(sequence.wanted, history, partial(predictor.read, sequence)):
                    parts[-1].update(found.labels[None], sequence.truth(frame, model.geometry, trained.data.ignore))
                    progress.advance()
        left = [merged(parts[:k] + parts[k + 1 :]) for k in range(len(parts))]
        without = {key: np.array([one[key] for one in left]) for key in KEYS}
        first = first or without
        figures = merged(parts)
        cells = [f"{figures[key]:.4f} ({jackknife_error(without[key] - first[key]):.4f})" for key in KEYS]
        rows.append([name, *cells])
        print(in_columns(["ranges", *KEYS], rows), flush=True)


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
