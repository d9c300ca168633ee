"""Checkpoint and rig -> program file, and its contract beside it."""

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
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
from omniocc.predict.network import load_occupancy, trained_image_width

SUFFIXES = (".pt2", ".onnx")


@dataclass(frozen=True)
class Options:
    """What `src/export.py` was asked for.

    Attributes:
        checkpoint: of the occupancy stage.
        rig: cameras, for which the program is made.
        output: file to write, .pt2 or .onnx.
        image_width: of the images that the program takes, px; None: as in training.
    """

    checkpoint: Path
    rig: Rig
    output: Path
    image_width: int | None


def export_files(options: Options) -> str:
    """Writes the program and, beside it, its contract as JSON; a line about them.

    Raises:
        FileNotFoundError, UserError: if the checkpoint, the rig, the output or an option of the model does not do.
    """
    output = options.output
    if output.suffix not in SUFFIXES:
        raise UserError(f"output={output}: its name must end with one of {', '.join(SUFFIXES)}")
    model, cfg = load_occupancy(options.checkpoint)
    rig = scaled(options.rig, options.image_width or trained_image_width(cfg))
    module = make_module(model, rig)
    program = export_program(module)
    contract = contract_of(module)
    write_program(program, contract, output)
    facts = {"program": output.name, "checkpoint": str(options.checkpoint), "torch": torch.__version__}
    atomic_write(output.with_suffix(".json"), json.dumps(facts | contract, indent=2) + "\n")
    return f"{output}: {output.stat().st_size / 2**20:.0f} MiB; inputs and outputs: {output.with_suffix('.json')}"


def scaled(rig: Rig, width: int) -> Rig:
    """The rig at the size of the images that go in.

    Raises:
        UserError: if its images have no common size.
    """
    sizes = {(camera.width, camera.height) for camera in rig.cameras}
    try:
        if len({camera_width * 1000 // camera_height for camera_width, camera_height in sizes}) > 1:
            raise ValueError(f"its images are of different shapes, {sorted(sizes)} px")
        return rig.resized(*even_size(rig.cameras[0], width))
    except ValueError as error:
        raise UserError(f"the rig's images cannot be brought to one size: {error}") from error


def write_program(program: ExportedProgram, contract: dict[str, Any], output: Path) -> None:
    """Write one file, of the kind that its name says, whole or not at all.

    Raises:
        UserError: if packages are missing or an operator has no counterpart in ONNX.
        DataError: when the disk refuses.
    """
    if output.suffix == ".onnx":
        inputs, outputs = ([port["name"] for port in contract[side]] for side in ("inputs", "outputs"))
        atomic_write(output, onnx_bytes(program, inputs, outputs))
    else:
        buffer = io.BytesIO()
        torch.export.save(program, buffer)
        atomic_write(output, buffer.getbuffer())


def load_program(path: Path) -> Callable[..., Any]:
    """A .pt2 file as a function; torch alone suffices: `torch.export.load(path).module()`."""
    return torch.export.load(path).module()
