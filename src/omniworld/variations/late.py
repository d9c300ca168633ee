"""A camera whose images are older than their time stamps."""

from dataclasses import replace

import numpy as np

from omniocc.frame import Frame
from omniworld.render.capture import expose
from omniworld.scene import Scene

LONGEST_MS = 200.0
"""Longest delay: a scene cannot be seen earlier before its first frame."""


class LateCamera:
    """The frames of a scene in which one camera shows what it saw earlier, from where the car was then.

    All labels are those of the frame's own time, but classes and ranges of the late camera's pixels, which are those of
    its image.

    Args:
        camera: number of the late camera.
        delay_s: how much older its images are than their time stamps.
        seed: of the noise in its images.
    """

    def __init__(self, scene: Scene, camera: int, delay_s: float, seed: int) -> None:
        self.scene, self.camera, self.delay_s, self.seed = scene, camera, delay_s, seed

    def frame(self, index: int) -> Frame:
        """Return the frame with this number; raise ValueError if it is negative."""
        frame = self.scene.frame(index)
        snapshot, _ = self.scene.snapshot(frame.time_s - self.delay_s)
        view, render = self.scene.recorder.views[self.camera], self.scene.recorder.renderers[self.camera]
        rng = np.random.default_rng([self.seed, index, self.camera])
        seen = expose(view, render(snapshot), snapshot.light, self.scene.sensor, rng)
        images, semantics, range_m = frame.images.copy(), frame.semantics.copy(), frame.range_m.copy()
        images[self.camera], semantics[self.camera], range_m[self.camera] = seen.rgb, seen.label, seen.range_m
        return replace(frame, images=images, semantics=semantics, range_m=range_m)
