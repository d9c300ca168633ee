"""Write the program of a checkpoint and a rig, and the description of its inputs and outputs."""

import io
import json
import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.export import ExportedProgram

from omniocc.camera import Rig
from omniocc.errors import UserError, first_line, installing
from omniocc.export.contract import contract_of
from omniocc.export.program import export_program, make_module
from omniocc.io import atomic_write
from omniocc.predict.input.images import check_width, even_size
from omniocc.predict.input.sequence import with_road
from omniocc.predict.predictor import seen_cells
from omniocc.predict.trained import load

SUFFIXES = (".pt2", ".onnx")


def export_files(
    checkpoint: str, rig: Rig, output: Path, image_width: int | None = None, road_z_m: float | None = None
) -> str:
    """Write the program, and beside it the description of its inputs and outputs and the cells that a camera sees.

    Return a line about these files.

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
    check_width(image_width)
    found = load(checkpoint)
    model, trained = found.occupancy, found.facts
    rig, height_m, line = trained.place(with_road(rig, road_z_m))
    if line:
        print(f"road: {line}", file=sys.stderr, flush=True)
    rig = scale_rig(rig, trained.width_for(rig) if image_width is None else image_width)
    module = make_module(model, rig, found.occupied_above)
    print(f"tracing the network of {found.path}: half a minute or more", file=sys.stderr, flush=True)
    program = export_program(module)
    contract = contract_of(module, trained.classes, height_m)
    print(f"writing {output}", file=sys.stderr, flush=True)
    write_program(program, contract, output)
    facts = {"program": output.name, "checkpoint": str(found.path), "torch": torch.__version__}
    facts["frame_interval_s"] = trained.frame_interval_s
    pose, content = torch.eye(4, dtype=torch.float64), io.BytesIO()
    np.save(content, seen_cells(model.geometry, [(rig, pose)], pose).numpy())
    seen, described = (output.with_name(f"{output.name}.{end}") for end in ("seen.npy", "json"))
    atomic_write(seen, content.getbuffer())
    atomic_write(described, json.dumps(facts | contract | {"seen": seen.name}, indent=2) + "\n")
    size_mib = output.stat().st_size / 2**20
    return f"{output}: {size_mib:.0f} MiB; cells that a camera sees: {seen}; inputs and outputs: {described}"


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


def onnx_bytes(program: ExportedProgram, inputs: list[str], outputs: list[str]) -> bytes:
    """Return the content of an ONNX file, given the names of the program's inputs and outputs, in order.

    Raises:
        UserError: when packages are missing or ONNX lacks an operator.
    """
    try:
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise UserError(f"ONNX needs more packages, which .pt2 does not: {installing('export')}") from error
    program = program.run_decompositions(DECOMPOSITIONS)
    try:
        with without_notices():
            written = torch.onnx.export(program, dynamo=True, input_names=inputs, output_names=outputs, verbose=False)
    except torch.onnx.OnnxExporterError as error:
        raise UserError(f"ONNX lacks an operator: {first_line(error)}") from error
    assert written is not None
    model = written.model_proto
    use_float32_arctangents(model)
    return model.SerializeToString()


@contextmanager
def without_notices() -> Iterator[None]:
    """Silence what the exporting libraries log below the level ERROR, such as a line for every empty attribute list."""
    loggers = [logging.getLogger(name) for name in ("onnx_ir", "onnxscript", "torch.onnx")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        try:
            for logger in loggers:
                logger.setLevel(logging.ERROR)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


def use_float32_arctangents(model: Any) -> None:
    """Compute the float64 arctangents of an ONNX model in float32: onnxruntime 1.31 has none for float64."""
    import onnx

    values = [*model.graph.value_info, *model.graph.input]
    double = {value.name for value in values if value.type.tensor_type.elem_type == onnx.TensorProto.DOUBLE}
    nodes = []
    for node in model.graph.node:
        if node.op_type == "Atan" and node.input[0] in double:
            source, result = f"{node.output[0]}_from", f"{node.output[0]}_single"
            nodes.append(onnx.helper.make_node("Cast", [node.input[0]], [source], to=onnx.TensorProto.FLOAT))
            nodes.append(onnx.helper.make_node("Atan", [source], [result], name=node.name))
            nodes.append(onnx.helper.make_node("Cast", [result], [node.output[0]], to=onnx.TensorProto.DOUBLE))
        else:
            nodes.append(node)
    del model.graph.node[:]
    model.graph.node.extend(nodes)


def embedding_bag(
    weight: Tensor,
    indices: Tensor,
    offsets: Tensor,
    scale_grad_by_freq: bool = False,
    mode: int = 0,
    sparse: bool = False,
    per_sample_weights: Tensor | None = None,
    include_last_offset: bool = False,
    padding_idx: int | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute `embedding_bag` (mode sum), which ONNX lacks, as a gather and a scattered sum."""
    assert mode == 0
    assert per_sample_weights is not None
    assert not include_last_offset
    begins = torch.zeros(len(indices) + 1, dtype=torch.int64)  # empty bags at the end begin after the last index
    begins = begins.index_add(0, offsets.long(), torch.ones(len(offsets), dtype=torch.int64))
    bag = begins.cumsum(0)[:-1] - 1
    rows = weight.index_select(0, indices.long()) * per_sample_weights[:, None]
    sums = weight.new_zeros(len(offsets), weight.shape[1]).index_add(0, bag, rows)
    return sums, bag, bag, bag


def convolution3d(
    volume: Tensor,
    weight: Tensor,
    bias: Tensor | None = None,
    stride: Any = (1, 1, 1),
    padding: Any = (0, 0, 0),
    dilation: Any = (1, 1, 1),
    groups: int = 1,
) -> Tensor:
    """Compute a convolution with an explicit zero bias: onnxscript 0.7 gives a missing one a wrong shape."""
    if bias is None:
        bias = weight.new_zeros(len(weight))
    return torch.ops.aten.convolution(
        volume, weight, bias, stride, padding, dilation, transposed=False, output_padding=[0, 0, 0], groups=groups
    )


DECOMPOSITIONS: dict[Any, Any] = {
    torch.ops.aten.embedding_bag.padding_idx: embedding_bag,
    torch.ops.aten.conv3d.default: convolution3d,
}
