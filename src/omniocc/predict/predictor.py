"""Apply a depth option to one frame, or an occupancy model to one frame after the other, with or without history."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.masks import mask_cameras
from omniocc.errors import UserError
from omniocc.model import OccupancyModel, Stream
from omniocc.model.depth import DepthMap
from omniocc.model.protocols import LearnedSketch, Sketched, learns
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.input.schedule import History, schedule
from omniocc.predict.stopwatch import Stopwatch

Images = Sequence[UInt8[np.ndarray, "H W 3"]]
"""RGB of every camera of a rig, in its order."""
STEPS: tuple[str, ...] = ("read", "depth", "sketch", "occupancy", "write")
"""Steps of a prediction whose time is measured, in order."""
NOT_FINITE = "the network returns NaN: its weights are damaged, use another checkpoint"


class PredictedFrame(NamedTuple):
    """The prediction for one frame, on the CPU.

    Attributes:
        labels: class of every cell.
        candidates: cells that the sketch chose.
        range_m: the depth network's panorama, nan where it predicts no range; None for a sketch without depth.
    """

    labels: UInt8[Tensor, "X Y Z"]
    candidates: Bool[Tensor, "X Y Z"]
    range_m: Float32[Tensor, "h w"] | None


class Input(NamedTuple):
    """One frame for the model.

    Attributes:
        images: RGB in [0, 1], padded where the sizes of cameras differ.
        rig: the cameras at that size.
        world_from_ego: pose of the frame; None without history.
        true_range_m: recorded range panorama, for the depth option that returns it; None if there is none.
        original: the images before they were scaled; empty if nobody needs them.
    """

    images: Float32[Tensor, "1 N 3 H W"]
    rig: Rig
    world_from_ego: Float64[Tensor, "4 4"] | None = None
    true_range_m: Float32[Tensor, "1 h w"] | None = None
    original: Images = ()


def predict_depth(model: nn.Module, images: Float32[Tensor, "1 N 3 H W"], rig: Rig, device: torch.device) -> DepthMap:
    """Return the range panorama that a depth option computes on `device` from the images of one frame, on the CPU.

    The images are in [0, 1], and the rig is the one at their size.

    Raises:
        UserError: when the option needs more than images, or returns NaN.
    """
    with torch.inference_mode():
        try:
            depth = model.to(device)(images.to(device), (rig,))
        except ValueError as error:
            raise UserError(str(error)) from error
        depth = DepthMap(*(part.cpu() for part in depth))
    if not bool(depth.range_m.isfinite().all()):
        raise UserError(NOT_FINITE)
    return depth


class Predictor:
    """Predicts frame after frame; the lifted volumes of past frames are reused within a sequence.

    Args:
        model: in evaluation mode.
        image_width: approximate width that images are scaled to, px; None: the rig's.
        excluded: names of the cameras to leave out.
        device: to compute on.
    """

    def __init__(self, model: OccupancyModel, image_width: int | None, excluded: Sequence[str], device: torch.device):
        self.model = model.to(device)
        self.image_width = image_width
        self.excluded = tuple(excluded)
        self.device = device
        self.stream = Stream(self.model)

    @property
    def panorama(self) -> Equirectangular | None:
        """Return the directions of the depth network's panorama, None for a sketch without depth."""
        return None if self.learned_sketch is None else self.learned_sketch.panorama

    @property
    def learned_sketch(self) -> LearnedSketch | None:
        """Return the model's sketch if it uses ranges, else None."""
        sketch = self.model.sketch
        return cast(LearnedSketch, sketch) if learns(type(sketch)) else None

    def scaled(self, images: Images, rig: Rig) -> tuple[Float32[Tensor, "1 N 3 H W"], Rig]:
        """Return the images of a frame, of any size, scaled to the width, those of left-out cameras black; and the rig.

        Raises:
            UserError: when the cameras cannot be brought to one size.
        """
        shown = [
            np.zeros_like(image) if name in self.excluded else image
            for image, name in zip(images, rig.names, strict=True)
        ]
        return resized_to_width(shown, rig, self.image_width)

    def frames(
        self, wanted: Sequence[int], history: History, read: Callable[[int], Input]
    ) -> Iterator[tuple[int, Input, PredictedFrame, Stopwatch]]:
        """Yield the wanted frames of a sequence with their predictions, and the time that each took.

        Args:
            wanted: their indices, increasing.
            history: how they get their past.
            read: returns a frame, wanted or of the past of one.

        Raises:
            UserError: as `step`.
        """
        for lift in schedule(wanted, self.model.temporal.frames, history):
            if lift.reset:
                self.stream.reset()
            watch = Stopwatch(self.device, STEPS)
            with watch("read"):
                given = read(lift.frame)
            prediction = self.step(given, watch)
            if lift.wanted:
                yield lift.frame, given, prediction, watch

    @torch.inference_mode()
    def step(self, given: Input, watch: Stopwatch) -> PredictedFrame:
        """Return the prediction for the next frame; `watch` measures the time of depth, sketch and occupancy.

        Raises:
            UserError: when images and modules do not fit together, or the network returns NaN.
        """
        images, pose = given.images.to(self.device), given.world_from_ego
        pose = torch.eye(4, dtype=torch.float64) if pose is None else pose
        try:
            sketched, depth = self._choose(images, given, watch)
            with watch("occupancy"):
                seen = mask_cameras(given.rig, self.excluded)
                logits = self.stream.step(images[0], seen, pose.to(self.device), sketched)
                labels = logits.argmax(0).to(torch.uint8).cpu()
        except ValueError as error:
            raise UserError(str(error)) from error
        if not bool(logits.isfinite().all()):
            raise UserError(NOT_FINITE)
        range_m = None if depth is None else depth.known_range_m()[0].cpu()
        return PredictedFrame(labels, sketched.candidates[0].cpu(), range_m)

    def _choose(self, images: Tensor, given: Input, watch: Stopwatch) -> tuple[Sketched, DepthMap | None]:
        """Return the candidates and their ranges; depth ignores the black images of excluded cameras."""
        sketch = self.learned_sketch
        if sketch is None:
            with watch("sketch"):
                return self.model.sketch(images, (given.rig,)), None
        with watch("depth"):
            true_range_m = None if given.true_range_m is None else given.true_range_m.to(self.device)
            depth = sketch.depth(images, (given.rig,), true_range_m)
        with watch("sketch"):
            return sketch.propose(depth.range_m, depth.valid), depth
