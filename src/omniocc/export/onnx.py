"""Convert an exported program to ONNX."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.export import ExportedProgram

from omniocc.errors import UserError, first_line, installing


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
    """Silence what the exporting libraries print below an error, such as a line for every empty list of attributes."""
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
    return torch.ops.aten.convolution(volume, weight, bias, stride, padding, dilation, False, [0, 0, 0], groups)


DECOMPOSITIONS: dict[Any, Any] = {
    torch.ops.aten.embedding_bag.padding_idx: embedding_bag,
    torch.ops.aten.conv3d.default: convolution3d,
}
