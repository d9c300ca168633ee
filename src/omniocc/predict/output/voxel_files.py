"""Files of predicted voxels."""

import io
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular
from omniocc.classes import FREE, UNKNOWN, ClassTable, SemanticClass
from omniocc.data.formats.arrays import npz_arrays
from omniocc.errors import UserError
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.io import atomic_write
from omniocc.predict.output.range_files import ply_bytes
from omniocc.predict.predictor import PredictedFrame
from rayiou.labels import ids_beyond
from rayiou.surface import drop_flat_faces, extract_surface

VOXELS, MESH = "voxels.npz", "voxels.ply"

FRAME = "ego: x forward, y left, z up, metres, origin as in the rig file"


def voxel_arrays(
    prediction: PredictedFrame, geometry: Grid, classes: ClassTable, world_from_ego: Float64[Tensor, "4 4"] | None
) -> dict[str, np.ndarray]:
    """Return by name all arrays that another program needs to place and name the voxels, the pose if it is known.

    `probability[0]` is that of an occupied cell; `probability[1]` that an occupied cell has its most likely class.

    Cell (i, j, k) spans `low + (high - low) * ((i, j, k) + (0 .. 1)) / shape` along the three `axes`.
    """
    axes = ("r_m", "theta_rad", "z_m") if isinstance(geometry, Cylinder) else ("x_m", "y_m", "z_m")
    low, high = np.array(geometry.bounds, dtype=np.float64).T
    arrays = {
        "labels": prediction.labels.numpy(),
        "candidates": prediction.candidates.numpy(),
        "probability": prediction.probability.numpy(),
        "seen": prediction.seen.numpy(),
        "kind": np.array(type(geometry).__name__.lower()),
        "axes": np.array(axes),
        "shape": np.array(geometry.shape),
        "low": low,
        "high": high,
        "frame": np.array(FRAME),
        "class_names": np.array(classes.names),
        "class_colors": classes.palette[: classes.num_classes],
    }
    return arrays if world_from_ego is None else {**arrays, "world_from_ego": world_from_ego.numpy()}


def range_arrays(
    range_m: Float32[Tensor, "h w"], panorama: Equirectangular, origin_z_m: float
) -> dict[str, np.ndarray]:
    """Return by name the arrays of a range panorama whose origin lies `origin_z_m` above the ego origin of the file."""
    edges = {"top_deg": np.array(panorama.top_deg), "bottom_deg": np.array(panorama.bottom_deg)}
    return {"range_m": range_m.numpy(), "range_origin_z_m": np.array(origin_z_m), **edges}


def raise_grid(geometry: Grid, height_m: float) -> Grid:
    """Return the grid in a frame whose origin is `height_m` lower."""
    assert isinstance(geometry, Cylinder | Cuboid)
    low, high = geometry.height_m
    return replace(geometry, height_m=(low + height_m, high + height_m))


def write_mesh(folder: Path, labels: UInt8[Tensor, "X Y Z"], geometry: Grid, classes: ClassTable) -> None:
    """Write `voxels.ply`, the surface of the voxels in the colours of their classes.

    Raises:
        DataError: naming the file that cannot be written.
    """
    atomic_write(folder / MESH, ply_bytes(*voxel_mesh(labels, geometry, classes)))


def write_voxels(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write `voxels.npz`, whole or not at all; its existence marks a frame as finished.

    Raises:
        DataError: naming the file that cannot be written.
    """
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    atomic_write(folder / VOXELS, content.getvalue())


class Voxels(NamedTuple):
    """The content of `voxels.npz`."""

    labels: UInt8[Tensor, "X Y Z"]
    candidates: Bool[Tensor, "X Y Z"]
    geometry: Grid
    classes: ClassTable
    world_from_ego: Float64[np.ndarray, "4 4"] | None
    range_m: Float32[np.ndarray, "h w"] | None = None


def read_voxels(path: Path) -> Voxels:
    """Return what `write_voxels` has written of the arrays of `voxel_arrays` and `range_arrays`.

    Raises:
        UserError: when the file is damaged or of another program.
    """
    try:
        given = npz_arrays(path)
        names, colors = given["class_names"].tolist(), given["class_colors"].tolist()
        rows = zip(names, colors, strict=True)
        classes = ClassTable(tuple(SemanticClass(k, str(name), tuple(rgb)) for k, (name, rgb) in enumerate(rows)))
        ends = list(zip(given["low"].tolist(), given["high"].tolist(), strict=True))
        kind, shape = str(given["kind"]), given["shape"].tolist()
        geometry = Cylinder(shape, ends[0], ends[2]) if kind == "cylinder" else Cuboid(shape, *ends)
        if wrong := ids_beyond(given["labels"], classes.num_classes):
            raise ValueError(f"its labels hold {wrong}, but it has {classes.num_classes} classes")
        labels, candidates = torch.from_numpy(given["labels"].astype(np.uint8)), torch.from_numpy(given["candidates"])
        if not labels.shape == candidates.shape == geometry.shape:
            raise ValueError(f"its labels have the shape {tuple(labels.shape)}, its grid {geometry.shape}")
    except Exception as error:  # numpy, zipfile and zlib raise their own types
        raise UserError(f"{path} is damaged or no file of predict.py occupancy: {error!r}") from error
    return Voxels(labels, candidates.bool(), geometry, classes, given.get("world_from_ego"), given.get("range_m"))


def read_labels(folder: Path, geometry: Grid) -> UInt8[Tensor, "X Y Z"]:
    """Return the labels of a finished frame.

    Raises:
        UserError: when the file is damaged or belongs to another grid.
    """
    path = folder / VOXELS
    try:
        labels = npz_arrays(path, ["labels"])["labels"]
    except Exception as error:  # numpy, zipfile and zlib raise their own types
        raise UserError(f"{path} is damaged: {error}; force=true predicts all frames again") from error
    if labels.shape != geometry.shape:
        raise UserError(f"{path} has the grid {labels.shape}, not {geometry.shape}; force=true predicts it again")
    return torch.from_numpy(labels)


class VoxelMesh(NamedTuple):
    """Four vertices and two triangles per face, so that every face has one colour.

    Attributes:
        points_m: (V, 3) float64, ego frame.
        colors: (V, 3) uint8 RGB, of the class.
        triangles: (T, 3) indices of vertices, counter-clockwise seen from outside.
    """

    points_m: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray


def voxel_mesh(labels: UInt8[Tensor, "X Y Z"], geometry: Grid, classes: ClassTable) -> VoxelMesh:
    """Return the faces of occupied cells towards cells that are not; unknown cells count as empty."""
    quads, cells = drop_flat_faces(extract_surface((labels != FREE) & (labels != UNKNOWN), geometry))
    colors = classes.palette[labels.reshape(-1).numpy()[cells]]
    first = 4 * np.arange(len(quads))[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return VoxelMesh(quads.reshape(-1, 3), np.repeat(colors, 4, axis=0), triangles)
