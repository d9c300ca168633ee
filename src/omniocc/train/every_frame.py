"""What a trained stage predicts for every frame, stored for the stages after it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.data import Dataset

from omniocc.data.loader import Loader
from omniocc.data.source import SceneFrames
from omniocc.data.store.frame_cache import FrameCache
from omniocc.progress import Progress
from omniocc.runs.distributed import rank_and_world_size
from omniocc.train.stage_task import StageTask

Inputs = tuple[Tensor | None, ...]
Read = Callable[[SceneFrames, int], Inputs]
"""Returns the inputs of a frame."""
Predict = Callable[..., tuple[Tensor, ...]]
"""Returns one array for each cache, and may return more, from a task, a rig and inputs as a batch of one."""


class FrameOutputs(NamedTuple):
    """What a stage predicts for every frame and keeps for later stages.

    Attributes:
        what: in a word, for the progress.
        scenes: all of whose frames are predicted.
        caches: one for each array.
        read: inputs of a frame.
        predict: arrays of a frame.
    """

    what: str
    scenes: Sequence[SceneFrames]
    caches: Sequence[FrameCache]
    read: Read
    predict: Predict

    def missing(self) -> list[SceneFrames]:
        """Return this process's share of the scenes that are missing in one of the caches."""
        rank, world_size = rank_and_world_size()
        own = self.scenes[rank::world_size]
        absent = {scene.name for cache in self.caches for scene in cache.missing(own)}
        return [scene for scene in own if scene.name in absent]

    def fill(
        self, missing: Sequence[SceneFrames], task: StageTask, device: torch.device, num_workers: int, title: str
    ) -> None:
        """Predict for all frames of these scenes on a device; loader processes read the inputs."""
        task.to(device).eval()
        inputs = iter(Loader(Frames(missing, self.read), None, num_workers, tuple))
        with Progress(f"{title}, {self.what}", sum(map(len, missing))) as progress, torch.inference_mode():
            for scene in missing:
                frames = []
                for frame in range(len(scene)):
                    predicted = self.predict(task, scene.rigs[frame], *batch_of_one(next(inputs), device))
                    frames.append([array.cpu() for array in predicted[: len(self.caches)]])
                    progress.advance()
                for cache, arrays in zip(self.caches, zip(*frames, strict=True), strict=True):
                    cache.write(scene, arrays)
        task.cpu()


class Frames(Dataset):
    """The inputs of every frame of some scenes, in order."""

    def __init__(self, scenes: Sequence[SceneFrames], read: Read):
        self.frames = [(scene, frame) for scene in scenes for frame in range(len(scene))]
        self.read = read

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Inputs:
        return self.read(*self.frames[index])


def batch_of_one(inputs: Inputs, device: torch.device) -> list[Tensor | None]:
    """Return tensors as a batch of one on a device."""
    return [None if value is None else value.unsqueeze(0).to(device) for value in inputs]
