"""Score depth networks on four real images of a car: `python tools/real_car.py FOLDER any-rig [more checkpoints]`.

FOLDER holds front.png, right.png, back.png and left.png of the surround-view sample (MIT licence) of
https://github.com/neozhaoliang/surround-view-system-introduction, taken with the built-in rig `surround_view`. Two
things are known there: the road with a cloth of 6 x 10 m on it, and where twelve things stand on the road.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import UserError
from omniocc.predict import load, predict_depth
from omniocc.predict.input.images import find_frames, read_frame, resized_to_width
from omniocc.runs.script import quiet_libraries
from omniocc.runs.table import markdown

CLOTH_M = ((-5.53, 4.45), (-3.0, 3.0))
"""Ends of the cloth along x and y of the rig's frame."""
HOLE_M = ((-3.53, 2.49), (-1.3, 1.1))
"""Ends of its hole, in which the car stands."""
BODY_M = 0.5
"""Height above the road at which the ranges of standing things are compared: a flat road is far behind them there."""
NEAR_ROAD, NEAR_THING = 0.1, 0.25
"""Relative errors up to which a range counts, on the cloth and on things."""
THINGS = {
    "grey car": ("right", (628, 134)),
    "white car behind it": ("right", (547, 92)),
    "black car": ("right", (244, 113)),
    "bush on the right": ("right", (680, 184)),
    "white hatchback": ("left", (340, 124)),
    "white car that faces us": ("left", (530, 88)),
    "van": ("left", (752, 156)),
    "bush on the left": ("left", (292, 165)),
    "hedge in front": ("front", (361, 334)),
    "end of the hedge": ("front", (790, 293)),
    "white car beside the road": ("front", (90, 394)),
    "shrubs behind": ("back", (301, 199)),
}
"""Camera and pixel (960 x 640) at which a thing meets the road, marked by hand."""


class Score(NamedTuple):
    """Fractions of the cloth's rays with an answer and within 10 %, their median relative error, things within 25 %."""

    answered: float
    near: float
    median: float
    things: int


def foot_points(rig: Rig) -> Float64[Tensor, "12 3"]:
    """Return where the things stand, in the frame of the rig, m."""
    points = []
    for name, pixel in THINGS.values():
        camera = rig.names.index(name)
        ray = rig.cameras[camera].unproject(torch.tensor(pixel, dtype=torch.float64))[0]
        pose = rig.ego_from_camera[camera].double()
        away, center = pose[:3, :3] @ ray, pose[:3, 3]
        points.append(center + away * (cast(float, rig.road_z_m) - center[2]) / away[2])
    return torch.stack(points)


def road_m(rays: Float[Tensor, "h w 3"], road_z_m: float) -> Float[Tensor, "h w"]:
    """Return the range of a flat road along rays from the origin, infinite above the horizon."""
    return torch.where(rays[..., 2] < 0, road_z_m / rays[..., 2].clamp(max=-1e-9), torch.inf)


def on_cloth(points_m: Float[Tensor, "h w 3"]) -> Bool[Tensor, "h w"]:
    """Return whether points of the road are on the cloth."""

    def inside(ends: tuple[tuple[float, float], tuple[float, float]]) -> Tensor:
        (back, front), (right, left) = ends
        x, y = points_m[..., 0], points_m[..., 1]
        return (x > back) & (x < front) & (y > right) & (y < left)

    return inside(CLOTH_M) & ~inside(HOLE_M)


def score(range_m: Float[Tensor, "h w"], panorama: Equirectangular, rig: Rig) -> Score:
    """Return the score of a panorama of ranges, nan where there is no answer."""
    rays = panorama.rays().double()
    true_m = road_m(rays, cast(float, rig.road_z_m))
    cloth = on_cloth(rays * torch.where(true_m.isfinite(), true_m, 0).unsqueeze(-1)) & true_m.isfinite()
    error = ((range_m - true_m) / true_m).abs()[cloth]
    answered = error.isfinite()
    bodies_m = foot_points(rig) + torch.tensor([0.0, 0.0, BODY_M])
    pixels, seen = panorama.project(bodies_m)
    columns, rows = pixels.round().long().unbind(-1)
    columns, rows = columns % panorama.width, rows.clamp(0, panorama.height - 1)
    distance_m = bodies_m.norm(dim=-1)
    wrong = ((range_m[rows, columns] - distance_m) / distance_m).abs()
    return Score(
        float(answered.double().mean()),
        float((error < NEAR_ROAD).double().mean()),
        float(error[answered].median()),
        int((seen & (wrong < NEAR_THING)).sum()),
    )


def predicted(model: nn.Module, folder: Path, rig: Rig, image_width: int | None) -> Float[Tensor, "h w"]:
    """Return the ranges that a network predicts from the images in a folder, nan where it has no answer."""
    (frame,) = find_frames(str(folder), rig, [])
    images, scaled = resized_to_width(read_frame(frame, rig), rig, image_width)
    return predict_depth(model, images, scaled, torch.device("cpu")).known_range_m()[0]


def main(folder: Path, checkpoints: list[str]) -> None:
    """Print a table of the checkpoints, each with and without the height of the road, and of a flat road."""
    quiet_libraries()
    rig, rows = Rig.load("surround_view"), {}
    for name in checkpoints:
        trained = load(name)
        model = trained.depth
        width, panorama = trained.facts.width_for(rig), cast(Equirectangular, model.panorama)
        flat = road_m(panorama.rays().double(), cast(float, rig.road_z_m))
        rows["a flat road at its height"] = score(flat, panorama, rig)
        rows[name] = score(predicted(model, folder, rig, width), panorama, rig)
        untold = predicted(model, folder, replace(rig, road_z_m=None), width)
        rows[f"{name}, not told the height"] = score(untold, panorama, rig)
    head = ["", "cloth: answered", "within 10 %", "median error", f"things within 25 %, of {len(THINGS)}"]
    cells = [[name, f"{s.answered:.0%}", f"{s.near:.0%}", f"{s.median:.0%}", str(s.things)] for name, s in rows.items()]
    print(markdown(head, cells))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the four images")
    parser.add_argument("checkpoints", nargs="+", help="files, or names of weights that come with the package")
    given = parser.parse_args()
    try:
        main(given.folder, given.checkpoints)
    except (UserError, FileNotFoundError) as error:
        sys.exit(str(error))
