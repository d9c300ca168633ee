"""Score depth networks on a real key frame of nuScenes against its LiDAR: `python tools/real_lidar.py FOLDER any-rig`.

FOLDER holds a key frame in mmdetection3d's form: one `.pkl` of version 2 (`data_list`), the image of each camera and
`*LIDAR_TOP*.bin`; `demo/data/nuscenes` of https://github.com/open-mmlab/mmdetection3d is one. Six pinhole cameras see
all azimuths, and a tenth of what they see is seen by two.
"""

import argparse
import pickle
import sys
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.models.pinhole import Pinhole
from omniocc.data.formats.files import image_size, read_image
from omniocc.data.formats.poses import rigid
from omniocc.errors import UserError
from omniocc.predict import load, predict_depth
from omniocc.predict.input.images import resized_to_width
from omniocc.runs.script import quiet_libraries
from omniocc.runs.table import markdown

NEAREST_M = 2.5
"""Points nearer than this, which may be of the own car, are left out."""
BODY_M = 0.5
"""Height above the road from which points count as standing things."""
ARRAYS = {
    "numpy.ndarray",
    "numpy.dtype",
    "_codecs.encode",
    *(f"{core}.multiarray.{name}" for core in ("numpy.core", "numpy._core") for name in ("_reconstruct", "scalar")),
}
"""Names by which pickles of arrays and numbers of numpy are read."""
EDGES_M = (8.5, 17.0, 25.6)


class KeyFrame(NamedTuple):
    """A real key frame, its origin in the middle of the cameras.

    Attributes:
        points_m: of the LiDAR, that a camera sees, (P, 3), in the frame of the rig.
    """

    rig: Rig
    images: list[np.ndarray]
    points_m: Float64[Tensor, "P 3"]


class PlainUnpickler(pickle.Unpickler):
    """Reads builtin types and arrays of numpy; whatever else a pickle names is refused."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what arrays are made of."""
        if f"{module}.{name}" in ARRAYS:
            return super().find_class(module, name)
        raise UserError(f"the .pkl names {module}.{name}, which is not read")


def only(folder: Path, pattern: str) -> Path:
    """Return the one file of a pattern; raise UserError if there is none or more than one."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise UserError(f"{folder} holds {len(found)} files {pattern}; one is needed")
    return found[0]


def read_key_frame(folder: Path) -> KeyFrame:
    """Return the key frame in a folder; the road is at the height 0 of its ego frame."""
    with only(folder, "*.pkl").open("rb") as file:
        info = PlainUnpickler(file).load()["data_list"][0]
    ego_from_lidar = rigid(np.array(info["lidar_points"]["lidar2ego"]), "lidar2ego")
    cameras, poses, images = [], [], []
    for name, camera in info["images"].items():
        path = only(folder, f"*__{name}__*.jpg")
        images.append(read_image(path, None, image_size(path)))
        k, (height, width) = np.array(camera["cam2img"]), images[-1].shape[:2]
        cameras.append(Pinhole(width, height, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2])))
        poses.append(ego_from_lidar @ np.linalg.inv(rigid(np.array(camera["lidar2cam"]), name)))
    ego_from_camera = torch.from_numpy(np.stack(poses))
    middle_m = ego_from_camera[:, :3, 3].mean(0)
    ego_from_camera[:, :3, 3] -= middle_m
    rig = Rig(tuple(cameras), ego_from_camera, tuple(info["images"]), road_z_m=-float(middle_m[2]))
    scan = np.fromfile(only(folder, "*LIDAR_TOP*.bin"), np.float32).reshape(-1, 5)[:, :3].astype(np.float64)
    points_m = torch.from_numpy(scan @ ego_from_lidar[:3, :3].T + ego_from_lidar[:3, 3]) - middle_m
    seen = rig.project(points_m)[1].any(0) & (points_m.norm(dim=-1) > NEAREST_M)
    return KeyFrame(rig, images, points_m[seen])


def compared(range_m: Tensor, points_m: Float64[Tensor, "P 3"], road_z_m: float) -> dict[str, list[str]]:
    """Return cells of a table for ranges in the directions of points, nan without an answer, by kind of point."""
    true_m = points_m.norm(dim=-1)
    error = ((range_m - true_m) / true_m).abs()
    standing = points_m[:, 2] > road_z_m + BODY_M
    kinds = {"road": ~standing, "standing things": standing}
    for low_m, high_m in zip((0.0, *EDGES_M[:-1]), EDGES_M, strict=True):
        kinds[f"{low_m:g}-{high_m:g} m"] = (true_m > low_m) & (true_m <= high_m)
    rows = {}
    for name, chosen in kinds.items():
        part = error[chosen]
        fractions = [part.isfinite(), part < 0.1, part < 0.25]
        rows[name] = [str(len(part)), *(f"{float(one.double().mean()):.0%}" for one in fractions)]
    return rows


def main(folder: Path, checkpoints: list[str]) -> None:
    """Print a table of the checkpoints and of a flat road."""
    quiet_libraries()
    frame = read_key_frame(folder)
    road_z_m = cast(float, frame.rig.road_z_m)
    down = frame.points_m[:, 2]
    flat_m = torch.where(down < 0, frame.points_m.norm(dim=-1) * road_z_m / down.clamp(max=-1e-9), torch.inf)
    ranges_m = {"a flat road": flat_m.where(down < 0, torch.nan)}
    for name in checkpoints:
        trained = load(name)
        model = trained.depth
        width, panorama = trained.facts.width_for(frame.rig), cast(Equirectangular, model.panorama)
        images, scaled = resized_to_width(frame.images, frame.rig, width)
        predicted_m = predict_depth(model, images, scaled, torch.device("cpu")).known_range_m()[0]
        pixels, valid = panorama.project(frame.points_m)
        column, row = pixels.round().long().unbind(-1)
        found_m = predicted_m[row.clamp(0, panorama.height - 1), column % panorama.width]
        ranges_m[name] = found_m.where(valid, torch.nan).double()
    cells = [
        [name, kind, *row]
        for name, range_m in ranges_m.items()
        for kind, row in compared(range_m, frame.points_m, road_z_m).items()
    ]
    print(markdown(["", "points", "number", "with an answer", "within 10 %", "within 25 %"], cells))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the key frame")
    parser.add_argument("checkpoints", nargs="+", help="files, or names of weights that come with the package")
    given = parser.parse_args()
    try:
        main(given.folder, given.checkpoints)
    except (UserError, FileNotFoundError) as error:
        sys.exit(str(error))
