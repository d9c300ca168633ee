"""Export the whole network for one rig as a program of plain operators with `torch.export`."""

import traceback
from typing import cast

import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor, nn
from torch.export import ExportedProgram

from omniocc.camera import Rig
from omniocc.errors import UserError, first_line
from omniocc.model import OccupancyModel, labels_of
from omniocc.model.ops.static import static_shapes
from omniocc.model.protocols import LearnedSketch, learns

SLOTS = ("backbone", "sketch", "lifter", "hints", "temporal", "refiner")


class Program(nn.Module):
    """A model for one rig.

    Args:
        model: in evaluation mode.
        rig: its cameras at the size of the images.
        occupied_above: see `omniocc.model.labels_of`.
    """

    def __init__(self, model: OccupancyModel, rig: Rig, occupied_above: float | None = None):
        super().__init__()
        self.model, self.rig, self.occupied_above = model, rig, occupied_above


class FrameProgram(Program):
    """The program of a model without history: one frame at a time."""

    def forward(self, images: UInt8[Tensor, "N 3 H W"]) -> UInt8[Tensor, "X Y Z"]:
        """Return the class of every cell from RGB 0..255."""
        pose = torch.eye(4, dtype=torch.float64, device=images.device)[None, None]
        there = torch.ones(1, 1, dtype=torch.bool, device=images.device)
        lifted = self.model.lift(images[None], (self.rig,))
        known = self.model.compute_hints(lifted, (self.rig,))
        logits, _ = self.model.fuse([lifted.volume], pose, there, lifted.sketched, known)
        return labels_of(logits[0], self.occupied_above)


class Step(Program):
    """The program of a model with history: one frame of a sequence. Its user keeps the volumes of the past frames."""

    def forward(
        self,
        images: UInt8[Tensor, "N 3 H W"],
        past_volumes: Float[Tensor, "P C X Y Z"],
        past_exists: Bool[Tensor, " P"],
        world_from_ego: Float64[Tensor, "T 4 4"],
    ) -> tuple[UInt8[Tensor, "X Y Z"], Float[Tensor, "C X Y Z"]]:
        """Return the class of every cell of the newest frame, and its volume, which the next frames need.

        The result is a plain tuple: a type of this package in the file would require the package to load it.

        Args:
            images: RGB 0..255.
            past_volumes: of the past frames, oldest first; any finite numbers where a frame does not exist.
            past_exists: whether each past frame exists.
            world_from_ego: poses of the past frames and, last, of the newest.
        """
        lifted = self.model.lift(images[None], (self.rig,))
        known = self.model.compute_hints(lifted, (self.rig,))
        exists = torch.cat([past_exists, torch.ones_like(past_exists[:1])])[None]
        volumes = [*past_volumes.split(1), lifted.volume]
        logits, _ = self.model.fuse(volumes, world_from_ego[None], exists, lifted.sketched, known)
        return labels_of(logits[0], self.occupied_above), lifted.volume[0]


def make_module(model: OccupancyModel, rig: Rig, occupied_above: float | None = None) -> FrameProgram | Step:
    """Return the program of a model, with or without history; freeze the model in evaluation mode."""
    kind = FrameProgram if model.temporal.frames == 1 else Step
    return kind(model.eval().requires_grad_(False), rig, occupied_above)


def example_inputs(module: FrameProgram | Step) -> tuple[Tensor, ...]:
    """Return inputs in the shapes that the program takes: black images, no past frames, identity poses."""
    camera, model = module.rig.cameras[0], module.model
    images = torch.zeros(len(module.rig.cameras), 3, camera.height, camera.width, dtype=torch.uint8)
    if isinstance(module, FrameProgram):
        return (images,)
    past = model.temporal.frames - 1
    volumes = torch.zeros(past, model.lifter.channels, *model.geometry.shape)
    poses = torch.eye(4, dtype=torch.float64).repeat(past + 1, 1, 1)
    return images, volumes, torch.zeros(past, dtype=torch.bool), poses


@torch.no_grad()
def export_program(module: FrameProgram | Step) -> ExportedProgram:
    """Return the exported program of a module.

    Raises:
        UserError: naming the option of the model that cannot be exported.
    """
    inputs = example_inputs(module)
    try:
        with static_shapes():
            module(*inputs)  # fills the caches of rig and grid, which become constants of the program
            return torch.export.export(module, inputs, strict=False)
    except Exception as error:  # operators and torch.export raise many types; the traceback tells the option
        raise UserError(f"{option_of(error, module.model)} cannot be exported: {first_line(error)}") from error


def option_of(error: BaseException, model: OccupancyModel) -> str:
    """Return the option in whose code an error was raised, as `model/slot=Class`."""
    parts = [(slot, getattr(model, slot)) for slot in SLOTS]
    if learns(type(model.sketch)):
        parts.insert(0, ("depth", cast(LearnedSketch, model.sketch).depth))
    owner = {
        id(module): (slot, part)
        for slot, part in reversed(parts)
        for module in (part.modules() if isinstance(part, nn.Module) else [part])
    }
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        if id(frame.f_locals.get("self")) in owner:
            slot, part = owner[id(frame.f_locals["self"])]
            return f"model/{slot}={type(part).__name__}"
    return "the model"
