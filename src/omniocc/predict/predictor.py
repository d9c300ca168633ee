"""Apply a depth option to one frame, or an occupancy model to one frame after the other, with or without history."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, Float16, Float32, Float64, UInt8
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.masks import mask_cameras
from omniocc.camera.pose import invert_pose
from omniocc.classes import UNKNOWN
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel, Stream, labels_of, probabilities_of
from omniocc.model.depth import DepthMap
from omniocc.model.ops.static import static_on_gpu
from omniocc.model.protocols import LearnedSketch, Sketched, learns
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.input.schedule import History, schedule
from omniocc.predict.input.sequence import FrameSequence
from omniocc.predict.stopwatch import Stopwatch

Images = Sequence[UInt8[np.ndarray, "H W 3"]]
"""RGB of every camera of a rig, in its order."""
STEPS: tuple[str, ...] = ("read", "depth", "sketch", "occupancy", "write")
"""Steps of a prediction whose time is measured, in order."""
NOT_FINITE = "the network returns NaN: its weights are damaged, use another checkpoint"


class PredictedFrame(NamedTuple):
    """The prediction for one frame, on the CPU.

    Attributes:
        labels: class of every cell; of those that no camera sees it is a guess, or 255 (`without_unseen`).
        candidates: cells that the sketch chose.
        range_m: the depth network's panorama, nan where it predicts no range; None for a sketch without depth.
        probability: that the cell is occupied; and if it is, that it has its most likely class.
        seen: cells whose centre some camera sees, now or in a past frame that is used; others may hide them.
    """

    labels: UInt8[Tensor, "X Y Z"]
    candidates: Bool[Tensor, "X Y Z"]
    range_m: Float32[Tensor, "h w"] | None
    probability: Float16[Tensor, "2 X Y Z"]
    seen: Bool[Tensor, "X Y Z"]

    def without_unseen(self) -> "PredictedFrame":
        """Return the frame with unknown labels (255) where no camera sees."""
        return self._replace(labels=self.labels.masked_fill(~self.seen, UNKNOWN))


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


def seen_cells(
    grid: Grid, views: Iterable[tuple[Rig, Float64[Tensor, "4 4"]]], world_from_ego: Float64[Tensor, "4 4"]
) -> Bool[Tensor, "X Y Z"]:
    """Return the cells around a pose whose centre falls on a usable pixel of some camera of these rigs and poses."""
    centers, seen = grid.centers(torch.float64), torch.zeros(grid.shape, dtype=torch.bool)
    for rig, pose in views:
        there_from_here = invert_pose(pose) @ world_from_ego
        points = centers @ there_from_here[:3, :3].T + there_from_here[:3, 3]
        for camera in range(len(rig.cameras)):
            seen |= rig.project_into(camera, points)[1]
    return seen


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
        occupied_above: see `omniocc.model.labels_of`.
    """

    def __init__(
        self,
        model: OccupancyModel,
        image_width: int | None,
        excluded: Sequence[str],
        device: torch.device,
        occupied_above: float | None = None,
    ):
        self.model = model.to(device)
        self.image_width = image_width
        self.excluded = tuple(excluded)
        self.device = device
        self.stream = Stream(self.model)
        self.occupied_above = occupied_above
        self._views: deque[tuple[Rig, Tensor]] = deque(maxlen=model.temporal.frames)

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

    def read(self, sequence: FrameSequence, frame: int) -> Input:
        """Return a frame of a sequence as `step` takes it. Errors are those of its images and of `scaled`."""
        images, poses = sequence.images(frame), sequence.world_from_ego
        pose = None if poses is None else poses[frame]
        return Input(*self.scaled(images, sequence.rig), pose, sequence.true_range_m(frame), images)

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
                self._views.clear()
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
            with static_on_gpu(self.device):
                sketched, depth = self._choose(images, given, watch)
                with watch("occupancy"):
                    unmasked = mask_cameras(given.rig, self.excluded)
                    self._views.append((unmasked, pose))
                    logits = self.stream.step(images[0], unmasked, pose, sketched)
                    found = labels_of(logits, self.occupied_above), probabilities_of(logits)
                    range_m = None if depth is None else depth.known_range_m()[0]
                    seen = seen_cells(self.model.geometry, self._views, pose)  # while a GPU still computes the rest
                    labels, probability = (part.cpu() for part in found)
        except ValueError as error:
            raise UserError(str(error)) from error
        if not bool(probability.isfinite().all()):
            raise UserError(NOT_FINITE)
        range_m = None if range_m is None else range_m.cpu()
        return PredictedFrame(labels, sketched.candidates[0].cpu(), range_m, probability, seen)

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
