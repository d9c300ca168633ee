"""A sequence frame by frame: every frame is lifted once, and its volume serves all windows that it is part of."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.hints import Known
from omniocc.model.occupancy import OccupancyModel
from omniocc.model.ops.padded import Images, joined
from omniocc.model.ops.static import static_on_gpu
from omniocc.model.protocols import Sketched, concatenate, part_of


class Remembered(NamedTuple):
    """One lifted frame."""

    volume: Float[Tensor, "1 C X Y Z"]
    sketched: Sketched
    known: Known
    world_from_ego: Float[Tensor, "4 4"]


Key = tuple[str, int]
"""Scene and number of a frame."""

MISSING: Key = ("", -1)
"""Key of frames that were not recorded."""


def window_keys(frame_ids: tuple[str, ...], exists: Bool[Tensor, "B T"]) -> list[list[Key]]:
    """Return the frames of windows of consecutive frames, oldest first; ids are `scene/number` of the newest frames."""
    windows = []
    for frame_id, recorded in zip(frame_ids, exists.tolist(), strict=True):
        scene, newest = frame_id.rsplit("/", 1)
        numbers = range(int(newest) - len(recorded) + 1, int(newest) + 1)
        keys = zip(numbers, recorded, strict=True)
        windows.append([(scene, number) if known else MISSING for number, known in keys])
    return windows


class Stream:
    """Predict as the model does, and remember lifted volumes; the model has to be in evaluation mode.

    Between calls it holds at most as many volumes as the temporal slot has past frames. Call `reset` when the model's
    weights have changed, and before another sequence.
    """

    def __init__(self, model: OccupancyModel):
        self.model = model
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._frames: dict[Key, Remembered] = {}
        self._number = 0

    def __len__(self) -> int:
        return len(self._frames)

    @torch.no_grad()
    def step(
        self,
        images: Images,
        rig: Rig,
        world_from_ego: Float[Tensor, "4 4"],
        sketched: Sketched | None = None,
    ) -> Float[Tensor, "C X Y Z"]:
        """Return logits of the next frame of a sequence; the past ones are those of the calls since `reset`."""
        window = [("", self._number - back) for back in reversed(range(self.model.temporal.frames))]
        self._number += 1
        with static_on_gpu(images.device):
            self._lift(window[-1:], images[None], (rig,), world_from_ego[None], sketched)
            return self._fuse([window])[0]

    @torch.no_grad()
    def windows(
        self,
        images: Images,
        rigs: tuple[tuple[Rig, ...], ...],
        world_from_ego: Float[Tensor, "B T 4 4"],
        sketched: Sketched | None,
        exists: Bool[Tensor, "B T"],
        frame_ids: tuple[str, ...],
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return the model's logits for these windows of consecutive frames (`scene/number` of the newest).

        Frames in order cost one lift each, in any other order more; the result is the same.
        """
        first = max(0, images.shape[1] - self.model.temporal.frames)
        windows = [window[first:] for window in window_keys(frame_ids, exists)]
        missing = {
            key: (sample, first + at)
            for sample, window in enumerate(windows)
            for at, key in enumerate(window)
            if key != MISSING and key not in self._frames
        }
        if missing:
            samples, frames = (list(column) for column in zip(*missing.values(), strict=True))
            selected = sketched and part_of(sketched, samples, frames)
            their_rigs = tuple(rigs[sample][frame] for sample, frame in missing.values())
            self._lift(list(missing), images[samples, frames], their_rigs, world_from_ego[samples, frames], selected)
        return self._fuse(windows)

    def _lift(
        self,
        keys: list[Key],
        images: Images,
        rigs: tuple[Rig, ...],
        world_from_ego: Float[Tensor, "M 4 4"],
        sketched: Sketched | None,
    ) -> None:
        assert not self.model.training
        lifted = self.model.lift(images, rigs, sketched)
        known = self.model.compute_hints(lifted, rigs)
        for index, (key, pose) in enumerate(zip(keys, world_from_ego, strict=True)):
            frame = Remembered(lifted.volume, lifted.sketched, known, pose)
            if len(keys) > 1:  # copies: views would keep what belongs to the whole batch
                own = part_of(lifted.sketched, [index]), part_of(known, [index])
                frame = Remembered(lifted.volume[index : index + 1].clone(), *own, pose)
            self._frames[key] = frame

    def _fuse(self, windows: list[list[Key]]) -> Float[Tensor, "B C X Y Z"]:
        """Return logits of windows of remembered frames; afterwards only what the next frame needs is remembered."""
        there = self._frames
        frames = [[there.get(key, there[window[-1]]) for key in window] for window in windows]
        volumes = [joined([frame.volume for frame in column]) for column in zip(*frames, strict=True)]
        poses = torch.stack([torch.stack([frame.world_from_ego for frame in window]) for window in frames])
        exists = torch.tensor([[key in there for key in window] for window in windows], device=poses.device)
        sketched, known = (
            concatenate([getattr(window[-1], part) for window in frames]) for part in ("sketched", "known")
        )
        self._frames = {key: there[key] for key in windows[-1][1:] if key in there}
        return self.model.fuse(volumes, poses, exists, sketched, known)[0]
