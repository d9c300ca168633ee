"""Replacements of operators that ONNX lacks compute the same values."""

import logging

import pytest
import torch
from torch.nn import functional as F

from omniocc.export.onnx import convolution3d, embedding_bag, without_notices


@pytest.mark.parametrize(
    "begins", [[0, 2, 5], [0, 0, 3, 7], [0, 4, 8, 8]], ids=["all full", "empty first", "empty last"]
)
def test_embedding_bag(begins):
    torch.manual_seed(0)
    table, weights = torch.randn(6, 4), torch.rand(8)
    rows, offsets = torch.randint(0, 6, (8,), dtype=torch.int32), torch.tensor(begins, dtype=torch.int32)
    expected = F.embedding_bag(rows, table, offsets, mode="sum", per_sample_weights=weights)
    found = embedding_bag(table, rows, offsets, per_sample_weights=weights)[0]
    torch.testing.assert_close(found, expected)


def test_convolution_without_bias():
    torch.manual_seed(0)
    volume, weight = torch.randn(1, 2, 4, 5, 6), torch.randn(3, 2, 3, 3, 3)
    found = convolution3d(volume, weight, None, [1, 1, 1], [1, 0, 1], [1, 1, 1], 1)
    torch.testing.assert_close(found, F.conv3d(volume, weight, padding=(1, 0, 1)))


def test_notices_of_the_exporting_libraries_are_silent_for_the_time_of_the_export(caplog):
    logger = logging.getLogger("onnx_ir")
    with without_notices():
        logger.warning("Attribute type is ambiguous")
        logger.error("this counts")
    logger.warning("afterwards")
    assert [record.message for record in caplog.records] == ["this counts", "afterwards"]
