"""An occupancy model at work: pictures of one moment after the other, with or without history."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import UserError
from omniocc.model import OccupancyModel, Stream
from omniocc.model.depth import DepthMap
from omniocc.model.protocols import LearnedSketch, Sketched, learns
from omniocc.predict.input.images import resized_to_width

STEPS: tuple[str, ...] = ("read", "depth", "sketch", "occupancy", "write")
"""What takes time, in order."""


class Answer(NamedTuple):
    """What the model says about one moment, on the CPU.

    Attributes:
        labels: class of every cell.
        candidates: cells that the sketch chose.
        range_m: the depth network's panorama, nan where it knows nothing; None for a sketch without depth.
    """

    labels: UInt8[Tensor, "X Y Z"]
    candidates: Bool[Tensor, "X Y Z"]
    range_m: Float32[Tensor, "h w"] | None


class Watch:
    """Seconds by step.

    Args:
        device: whose work is waited for.
    """

    def __init__(self, device: torch.device):
        self.device = device
        self.seconds: dict[str, float] = dict.fromkeys(STEPS, 0.0)

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        """Adds the time of a block to a step."""
        began_s = time.perf_counter()
        yield
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.seconds[step] += time.perf_counter() - began_s


class Predictor:
    """Predicts moment after moment; lifted volumes of past ones are reused until `reset`.

    Args:
        model: in evaluation mode.
        image_width: about the width to which pictures are scaled, px; None: the rig's.
        without: names of cameras to do without.
        device: where to compute.
    """

    def __init__(self, model: OccupancyModel, image_width: int | None, without: Sequence[str], device: torch.device):
        self.model = model.to(device)
        self.image_width = image_width
        self.without = tuple(without)
        self.device = device
        self.stream = Stream(self.model)

    @property
    def panorama(self) -> Equirectangular | None:
        """Directions of the depth network's answer, None for a sketch without depth."""
        return None if self.learned_sketch is None else self.learned_sketch.panorama

    @property
    def learned_sketch(self) -> LearnedSketch | None:
        """Return the model's sketch if it looks at ranges."""
        sketch = self.model.sketch
        return cast(LearnedSketch, sketch) if learns(type(sketch)) else None

    def reset(self) -> None:
        """The next moment has no history."""
        self.stream.reset()

    @torch.inference_mode()
    def step(
        self,
        images: Sequence[np.ndarray],
        rig: Rig,
        world_from_ego: Float64[Tensor, "4 4"] | None,
        true_range_m: Float32[Tensor, "1 h w"] | None,
        watch: Watch,
    ) -> Answer:
        """The answer for the next moment.

        Args:
            images: (H, W, 3) uint8 RGB of every camera, of any size.
            rig: the cameras.
            world_from_ego: its pose; None where it has no history.
            true_range_m: for a depth option that is nothing but the truth.
            watch: counts the time of depth, sketch and occupancy.

        Raises:
            UserError: when pictures and modules do not fit together, or the answer is no number.
        """
        with watch("read"):
            shown = [
                np.zeros_like(image) if name in self.without else image
                for image, name in zip(images, rig.names, strict=True)
            ]
            batch, scaled = resized_to_width(shown, rig, self.image_width)
            batch = batch.to(self.device)
        pose = torch.eye(4, dtype=torch.float64) if world_from_ego is None else world_from_ego
        try:
            sketched, depth = self._choose(batch, scaled, true_range_m, watch)
            with watch("occupancy"):
                seen = blinded(scaled, self.without)
                logits = self.stream.step(batch[0], seen, pose.to(self.device), sketched)
                labels = logits.argmax(0).to(torch.uint8).cpu()
        except ValueError as error:
            raise UserError(str(error)) from error
        if not bool(logits.isfinite().all()):
            raise UserError("the network answers with NaN: its weights are damaged, take another checkpoint")
        range_m = None if depth is None else depth.known_range_m()[0].cpu()
        return Answer(labels, sketched.candidates[0].cpu(), range_m)

    def _choose(
        self, images: Float[Tensor, "1 N 3 H W"], rig: Rig, true_range_m: Float32[Tensor, "1 h w"] | None, watch: Watch
    ) -> tuple[Sketched, DepthMap | None]:
        """Candidates, and the ranges that they come from; black pictures do not count for depth."""
        sketch = self.learned_sketch
        if sketch is None:
            with watch("sketch"):
                return self.model.sketch(images, (rig,)), None
        with watch("depth"):
            true_range_m = None if true_range_m is None else true_range_m.to(self.device)
            depth = sketch.depth(images, (rig,), true_range_m)
        with watch("sketch"):
            return Sketched(sketch.select(sketch.logits(depth.range_m, depth.valid))), depth


@lru_cache(maxsize=8)
def blinded(rig: Rig, names: tuple[str, ...]) -> Rig:
    """The rig with cameras that see nothing."""
    if not names:
        return rig
    masks = rig.masks or (None,) * len(rig.cameras)
    dark = [
        torch.zeros(camera.height, camera.width, dtype=torch.bool) if name in names else mask
        for camera, name, mask in zip(rig.cameras, rig.names, masks, strict=True)
    ]
    return Rig(rig.cameras, rig.ego_from_camera, rig.names, tuple(dark))
