"""Which pixels of a rig's cameras see their own car: what `src/mask.py` does with its options."""

from pathlib import Path

import numpy as np
import torch

from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data import SceneReader
from omniocc.data.store.files import list_folders
from omniocc.data.store.shard import META
from omniocc.draw import save_png
from omniocc.draw.sheet import camera_rows, inner_width, stack
from omniocc.errors import UserError
from omniocc.io import check_regular
from omniocc.predict.options import load_rig
from omniocc.progress import Progress
from omniworld.mesh.mesh import Mesh
from omniworld.render.own_car import Masks, car_under, grown, masking, own_car_pixels, read_obj

WIDTH = 1280
SEEN, MASKED = 225, 60
"""Grey of usable and masked pixels in the image."""


def mask_own_car(rig: str | None, scenes: str | None, car: str | None, grow_px: int, output: Path) -> None:
    """Find the pixels, write the masked rig and an image, print how much of each camera is masked.

    Args:
        rig: name or file of a rig, whose car is a mesh.
        scenes: instead a folder of recorded scenes; pixels that have a label in no frame are taken for the car.
        car: file of the mesh; None: the virtual world's car.
        grow_px: pixels that are masked around the car.
        output: file of the masked rig.

    Raises:
        UserError: naming the option or file that cannot be used.
    """
    if not isinstance(grow_px, int) or grow_px < 0:
        raise UserError(f"grow_px={grow_px}: give whole pixels, 0 or more")
    if rig is not None and scenes is None:
        known = load_rig(rig)
        pixels = own_car_pixels(known, car_of(known) if car is None else read_car(Path(car)))
    elif scenes is not None and rig is None:
        known, pixels = unlabelled(open_scenes(scenes))
    else:
        raise UserError("give either rig=... or scenes=...; see python src/mask.py --help")
    masked = masking(known, grown(pixels, grow_px))
    masked.save(output)
    masks = [masked.rays(camera)[1] for camera in range(len(known.cameras))]
    drawing = output.with_name(f"{output.stem}.masks.png")
    greys = [np.where(mask.numpy()[..., None], SEEN, MASKED).repeat(3, -1).astype(np.uint8) for mask in masks]
    save_png(drawing, stack(camera_rows(greys, inner_width(WIDTH), names=known.names), WIDTH))
    for name, before, after in zip(known.names, pixels, masks, strict=True):
        print(f"{name:12} own car {float(before.float().mean()):6.1%}   usable {float(after.float().mean()):6.1%}")
    if known.masks is not None:
        print("the rig was masked already: 'own car' is what is masked now in addition")
    print(f"rig       {output}\nimage     {drawing}")


def read_car(path: Path) -> Mesh:
    """Return the mesh of an OBJ file; raise UserError if a vertex is not within 100 m of the ego origin."""
    if path.exists():
        check_regular(path)
    car = read_obj(path)
    if not bool((np.abs(car.vertices) < 100).all()):  # false for nan too
        raise UserError(f"{path}: a vertex is not within 100 m of the ego origin; vertices are in m, in the ego frame")
    return car


def car_of(rig: Rig) -> Mesh:
    """Return the virtual world's car as it stands under a rig; raise UserError if a camera would be inside of it."""
    car = car_under(rig)
    if not len(car.faces):
        raise UserError(
            "a camera of this rig would be inside of the virtual world's car: give the mesh of yours, car=<file>.obj"
        )
    return car


def open_scenes(root: str) -> list[SceneReader]:
    """Return the recorded scenes of a folder; raise UserError if there are none, or their cameras differ."""
    if not Path(root).is_dir():
        raise UserError(f"scenes={root}: there is no such folder; give the folder that holds the scenes' folders")
    scenes = [SceneReader(Path(root) / name) for name in list_folders(root, META)]
    if not scenes:
        raise UserError(f"scenes={root}: there are no recorded scenes; give the folder that holds the scenes' folders")
    for scene in scenes[1:]:
        if scene.rig != scenes[0].rig:
            raise UserError(f"{scene.folder} has other cameras than {scenes[0].folder}; give scenes of one rig")
    return scenes


def unlabelled(scenes: list[SceneReader]) -> tuple[Rig, Masks]:
    """Return the rig of scenes, and for every camera the pixels without a label in every frame of all scenes."""
    rig = scenes[0].rig
    never = [rig.rays(camera)[1] for camera in range(len(rig.cameras))]
    with Progress("reading labels", sum(map(len, scenes))) as progress:
        for scene in scenes:
            for frame in range(len(scene)):
                labels = scene.pixel_labels(frame)
                if labels is None:
                    raise UserError(f"{scene.folder} has no classes of pixels; use rig=... car=<mesh> instead")
                never = [old & torch.from_numpy(new == UNKNOWN) for old, new in zip(never, labels, strict=True)]
                progress.advance()
    return rig, tuple(never)
