"""Recorded scenes with disturbed images and calibrations, and everything else as it was recorded."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch

from omniocc import seeding
from omniocc.camera import Rig
from omniocc.camera.masks import usable_pixels
from omniocc.data.augment.degrade import Image
from omniocc.data.source import SceneFrames
from omniocc.extras.robustness.disturb.disturbance import Disturbance


def disturb_scene(scene: SceneFrames, disturbance: Disturbance, name: str, seed: int) -> SceneFrames:
    """Return a scene with disturbed frames, which depend on the scene's name, the disturbance's name and the seed."""
    return cast(SceneFrames, DisturbedScene(scene, disturbance, name, seed))


class DisturbedScene:
    """A scene whose images and rigs are disturbed; all other attributes are those of the recorded scene.

    Pixels that the disturbed rig masks, and the recorded one does not, are black.
    """

    def __init__(self, scene: SceneFrames, disturbance: Disturbance, name: str, seed: int):
        self.scene, self.disturbance, self.disturbance_name, self.seed = scene, disturbance, name, seed

    def __getattr__(self, name: str) -> Any:
        if name == "scene":  # not there yet: the object is being unpickled
            raise AttributeError(name)
        return getattr(self.scene, name)

    def __len__(self) -> int:
        return len(self.scene)

    @property
    def undisturbed(self) -> SceneFrames:
        """Return the scene as it was recorded: its own cameras decide which cells were observed."""
        return self.scene

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """Return the cameras of every frame as the system believes them to be."""
        change = self.disturbance.rig
        if change is None:
            return tuple(self.scene.rigs)
        changed = {rig: change(rig, self._generator("rig")) for rig in dict.fromkeys(self.scene.rigs)}
        return tuple(changed[rig] for rig in self.scene.rigs)

    def images(self, frame: int) -> list[Image]:
        """Return the image of every camera, (H, W, 3) uint8 RGB each."""
        images, rig = self.scene.images(frame), self.scene.rigs[frame]
        if self.disturbance.images is not None:
            purpose = f"images {frame}" if self.disturbance.each_frame else "images"
            images = list(self.disturbance.images(images, rig, self._generator(purpose)))
        return images if self.rigs[frame] is rig else blackened(images, rig, self.rigs[frame])

    def _generator(self, purpose: str) -> np.random.Generator:
        return seeding.generator(self.scene.name, self.seed, f"{self.disturbance_name} {purpose}")


def blackened(images: Sequence[Image], rig: Rig, masked: Rig) -> list[Image]:
    """Return images that are black where `masked` allows no pixel and `rig` does."""
    triples = zip(images, usable_pixels(rig), usable_pixels(masked), strict=True)
    lost = ((image, before & ~after) for image, before, after in triples)
    return [image if not bool(torch.any(gone)) else image * ~gone.numpy()[..., None] for image, gone in lost]
