"""Write the program of a checkpoint and a rig, and the description of its inputs and outputs."""

import io
import json
import sys
from pathlib import Path
from typing import Any

import torch
from torch.export import ExportedProgram

from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.export.contract import contract_of
from omniocc.export.onnx import onnx_bytes
from omniocc.export.program import export_program, make_module
from omniocc.io import atomic_write
from omniocc.predict.input.images import even_size
from omniocc.predict.input.sequence import with_road
from omniocc.predict.trained import load

SUFFIXES = (".pt2", ".onnx")


def export_files(
    checkpoint: str, rig: Rig, output: Path, image_width: int | None = None, road_z_m: float | None = None
) -> str:
    """Write the program and, beside it, the description of its inputs and outputs as JSON; return a line about them.

    Args:
        checkpoint: of the occupancy stage: a file, a run's folder, or the name of shipped weights.
        rig: cameras that the program is for.
        output: file to write, .pt2 or .onnx.
        image_width: width of the images that the program takes, px; None: as many pixels as in training.
        road_z_m: height of the road in the frame of the rig, m; None: that of the rig file, or unknown.

    Raises:
        FileNotFoundError, UserError: when the checkpoint, rig, output or an option of the model cannot be used.
    """
    if output.suffix not in SUFFIXES:
        raise UserError(f"output={output}: its name must end with one of {', '.join(SUFFIXES)}")
    found = load(checkpoint)
    model, trained = found.occupancy, found.facts
    rig, height_m, line = trained.place(with_road(rig, road_z_m))
    if line:
        print(f"road: {line}", file=sys.stderr, flush=True)
    rig = scale_rig(rig, image_width or trained.width_for(rig))
    module = make_module(model, rig)
    print(f"tracing the network of {found.path}: half a minute or more", file=sys.stderr, flush=True)
    program = export_program(module)
    contract = contract_of(module, trained.classes, height_m)
    print(f"writing {output}", file=sys.stderr, flush=True)
    write_program(program, contract, output)
    facts = {"program": output.name, "checkpoint": str(found.path), "torch": torch.__version__}
    facts["frame_interval_s"] = trained.frame_interval_s
    described = output.with_name(f"{output.name}.json")
    atomic_write(described, json.dumps(facts | contract, indent=2) + "\n")
    return f"{output}: {output.stat().st_size / 2**20:.0f} MiB; inputs and outputs: {described}"


def scale_rig(rig: Rig, width: int) -> Rig:
    """Return the rig at the size of the program's images.

    Raises:
        UserError: when its cameras cannot be brought to one size.
    """
    sizes = {(camera.width, camera.height) for camera in rig.cameras}
    try:
        if len({camera_width * 1000 // camera_height for camera_width, camera_height in sizes}) > 1:
            raise ValueError(f"its images have different aspect ratios, {sorted(sizes)} px")
        return rig.resized(*even_size(rig.cameras[0], width))
    except ValueError as error:
        raise UserError(f"the rig's images cannot be brought to one size: {error}") from error


def write_program(program: ExportedProgram, contract: dict[str, Any], output: Path) -> None:
    """Write one file, ONNX or torch.export by its suffix, whole or not at all.

    Raises:
        UserError: when packages are missing or ONNX lacks an operator.
        DataError: when the file cannot be written.
    """
    if output.suffix == ".onnx":
        inputs, outputs = ([port["name"] for port in contract[side]] for side in ("inputs", "outputs"))
        atomic_write(output, onnx_bytes(program, inputs, outputs))
    else:
        buffer = io.BytesIO()
        torch.export.save(program, buffer)
        atomic_write(output, buffer.getbuffer())
