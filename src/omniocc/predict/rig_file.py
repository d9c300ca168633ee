"""The command `rig.py`: a rig file to begin with, and a rig drawn and checked before anything is predicted."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from omniocc.camera import Camera, Rig
from omniocc.camera.masks import mask_cameras
from omniocc.camera.parallax import shared_view
from omniocc.camera.plausible import field_of, suspicious
from omniocc.camera.pose import angles_of
from omniocc.camera.rig import MODELS
from omniocc.camera.template import new_rig
from omniocc.data.formats.files import check_aspect
from omniocc.draw.canvas import encode_image
from omniocc.draw.rig import MAP_M, ground_points, rig_sheet
from omniocc.errors import DataError, UserError
from omniocc.images import content_of, rgb_of
from omniocc.io import atomic_write
from omniocc.predict.input.images import FrameFiles, describe_ignored_images, find_frames, swapped_images
from omniocc.predict.options import load_rig

KINDS = (".png", ".jpg", ".jpeg")


def write_rig_file(lens: str, cameras: int, file: Path, force: bool) -> None:
    """Write a rig file in which every key is explained.

    Raises:
        UserError: naming the option that cannot be used, or the file that is there already.
    """
    text = new_rig(lens, cameras)
    if file.exists() and not force:
        raise UserError(f"file={file}: it is there already; choose another name, or replace it by force=true")
    atomic_write(file, text)
    show = f"python src/rig.py show {shlex.quote(str(file))} images=<folder of images>"
    print(f"rig       {file}: put in your numbers, then: {show}")


def show_rig(
    source: str, images: str | Sequence[str] | None, output: Path, excluded: Sequence[str], image_bits: int | None
) -> None:
    """Draw a rig with the images of the first frame, print a table of its cameras and a line for what is suspicious.

    Raises:
        UserError, DataError: naming the rig, the image or the output that cannot be read or written.
    """
    if output.suffix.lower() not in KINDS:
        raise UserError(f"output={output}: the name of an image ends with {', '.join(KINDS)}")
    rig = load_rig(source)
    frame = None if images is None else find_frames(images, rig, excluded, image_bits)[0]
    rig = mask_cameras(rig, tuple(excluded))
    shown, findings, told = [None] * len(rig.names), suspicious(rig), list[str]()
    if frame is not None:
        shown = [file and rgb_of(content_of(file), str(file), frame.bit_depth) for file in frame.files]
        findings += [*suspicious_images(rig, frame, shown)]
        told = [*scaled_images(rig, shown)]
    sheet = rig_sheet(rig, shown, findings, f"rig {source}")
    atomic_write(output, encode_image(sheet, output.suffix[1:].lower()))
    print("\n".join(table(rig)))
    if rig.road_z_m is not None:
        shared = shared_view(rig, ground_points(rig.road_z_m, MAP_M, 100))
        print(f"ground    within {MAP_M} m, two or more cameras see {shared:.0%} of what any camera sees")
    print("".join(f"images    {line}\n" for line in told), end="")
    print("\n".join(f"look at   {line}" for line in findings) or "nothing suspicious")
    print(f"image     {output}")


def table(rig: Rig) -> list[str]:
    """Return the lines of a table with the facts that a wrong calibration shows in, one line a camera."""
    models = {model: name for name, model in MODELS.items()}
    width = max(map(len, ("camera", *rig.names)))
    lines = [f"{'camera':{width}}  {'lens':17} field of view  above road   pitch  resolution"]
    for name, camera, pose in zip(rig.names, rig.cameras, rig.ego_from_camera, strict=True):
        field = field_of(camera)
        above = "not known" if rig.road_z_m is None else f"{float(pose[2, 3]) - rig.road_z_m:7.2f} m"
        lines.append(
            f"{name:{width}}  {models[type(camera)]:17} {field.horizontal_deg:3.0f} x {field.vertical_deg:3.0f} deg  "
            f"{above:>10}  {angles_of(pose)[1]:+4.0f} deg  {field.px_per_deg:.1f} px/deg"
        )
    return lines


def is_scaled(size: tuple[int, int], camera: Camera) -> bool:
    """Return whether an image of this size, px, is a camera's whole image, up to the rounding of a pixel."""
    width, height = size
    return (
        abs(height - width * camera.height / camera.width) < 1 or abs(width - height * camera.width / camera.height) < 1
    )


def scaled_images(rig: Rig, images: Sequence[np.ndarray | None]) -> Iterator[str]:
    """Yield a line for every size of whole images (H, W, 3) that is not the calibration's."""
    found: dict[str, list[str]] = {}
    for name, camera, image in zip(rig.names, rig.cameras, images, strict=True):
        if image is None:
            continue
        size = image.shape[1], image.shape[0]
        if size != (camera.width, camera.height) and is_scaled(size, camera):
            times = f"{size[0] / camera.width:.3g} of the calibration's {camera.width}x{camera.height} px"
            words = f"{size[0]}x{size[1]} px, {times}"
            found.setdefault(words, []).append(f"'{name}'")
    for words, names in found.items():
        yield f"{', '.join(names)}: {words}; the rig is scaled to them"


def suspicious_images(rig: Rig, frame: FrameFiles, images: Sequence[np.ndarray | None]) -> Iterator[str]:
    """Yield a line for everything about a frame's images (H, W, 3) uint8 RGB that does not fit the rig."""
    fit, squeezed, grey, colour = True, [], [], []
    for name, camera, file, image in zip(rig.names, rig.cameras, frame.files, images, strict=True):
        if image is None:
            continue
        size = image.shape[1], image.shape[0]
        try:
            check_aspect(size, camera, str(file), f"camera '{name}'")
            squeezed += [f"'{name}'"] * (not is_scaled(size, camera))
        except DataError as error:
            fit = False
            yield str(error)
        (grey if bool((image == image[..., :1]).all()) else colour).append(f"'{name}'")
    if squeezed:
        yield f"images of almost the calibration's aspect ratio: {', '.join(squeezed)}; are some pixels cropped?"
    if grey and colour:
        yield f"grey images beside colour images: {', '.join(grey)}; are all cameras of one kind?"
    yield from filter(None, [describe_ignored_images([frame], rig), swapped_images(frame, rig) if fit else ""])
