"""Export the whole network for one rig as a file that runs without this package."""

from omniocc.export.contract import contract_of
from omniocc.export.files import export_files
from omniocc.export.program import FrameProgram, Step, example_inputs, export_program, make_module

__all__ = [
    "FrameProgram",
    "Step",
    "contract_of",
    "example_inputs",
    "export_files",
    "export_program",
    "make_module",
]
