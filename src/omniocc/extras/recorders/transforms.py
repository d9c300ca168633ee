"""The tree of coordinate frames in a ROS bag: which pose one frame has in another, and when."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from omniocc.data.formats.poses import inverse
from omniocc.errors import UserError, in_line
from omniocc.extras.recorders.poses import TimedPoses
from omniocc.extras.recorders.streams import interpolate


@dataclass
class FrameTree:
    """Poses of child frames in their parents.

    Attributes:
        static: parent_from_child by (parent, child).
        moving: times (s) and poses by (parent, child), in the order in which they were added.
    """

    static: dict[tuple[str, str], Float64[np.ndarray, "4 4"]] = field(default_factory=dict)
    moving: dict[tuple[str, str], list[tuple[float, Float64[np.ndarray, "4 4"]]]] = field(default_factory=dict)

    def add(self, parent: str, child: str, time_s: float | None, parent_from_child: Float64[np.ndarray, "4 4"]) -> None:
        """Add a pose; a time of None means that it never changes."""
        key = parent.lstrip("/"), child.lstrip("/")
        if time_s is None:
            self.static[key] = parent_from_child
        else:
            self.moving.setdefault(key, []).append((time_s, parent_from_child))

    def fixed(self, target: str, source: str) -> Float64[np.ndarray, "4 4"]:
        """Return target_from_source over poses that never change; raise UserError naming frames that there are."""
        pose = np.eye(4)
        for parent, child, downwards in self._chain(target, source, self.static):
            step = self.static[parent, child]
            pose = pose @ (step if downwards else inverse(step))
        return pose

    def over_time(self, target: str, source: str) -> TimedPoses:
        """Return target_from_source at the times of the moving pose between them that is stated most often.

        Other moving poses of the chain are interpolated at these times and held before the first and after the last.

        Raises:
            UserError: naming the frames that there are, or if nothing between the two moves.
        """
        chain = self._chain(target, source, {**self.static, **self.moving})
        steps = [(parent, child) for parent, child, _ in chain]
        streams = {step: timed(self.moving[step]) for step in steps if step in self.moving}
        if not streams:
            raise UserError(f"poses: tf states no moving pose between '{target}' and '{source}'")
        times_s = max(streams.values(), key=lambda stream: len(stream.times_s)).times_s
        poses = np.broadcast_to(np.eye(4), (len(times_s), 4, 4))
        for parent, child, downwards in chain:
            step = held(streams[parent, child], times_s) if (parent, child) in streams else self.static[parent, child]
            poses = poses @ (step if downwards else inverse(step))
        return TimedPoses(times_s, poses)

    def _chain(self, target: str, source: str, edges: Mapping[tuple[str, str], object]) -> list[tuple[str, str, bool]]:
        """Return the steps from target to source: parent, child, and whether the step goes to the child."""
        target, source = target.lstrip("/"), source.lstrip("/")
        steps: dict[str, list[tuple[str, tuple[str, str, bool]]]] = {}
        for parent, child in edges:
            steps.setdefault(parent, []).append((child, (parent, child, True)))
            steps.setdefault(child, []).append((parent, (parent, child, False)))
        before: dict[str, tuple[str, tuple[str, str, bool]] | None] = {target: None}
        queue = deque([target])
        while queue:
            here = queue.popleft()
            for other, step in steps.get(here, []):
                if other not in before:
                    before[other] = here, step
                    queue.append(other)
        if source not in before:
            known = in_line(", ".join(sorted(steps))) or "none"
            raise UserError(
                f"tf: there is no chain of poses from '{target}' to '{source}'; frames: {known}. A rig file "
                "(recorder.rig) and recorder.lidar.ego_from_lidar can state what the bag does not"
            )
        chain = []
        while last := before[source]:
            source, step = last
            chain.append(step)
        return chain[::-1]


def timed(samples: list[tuple[float, Float64[np.ndarray, "4 4"]]]) -> TimedPoses:
    """Return samples in the order of time; of equal times the first one."""
    times_s, first = np.unique([time_s for time_s, _ in samples], return_index=True)
    return TimedPoses(times_s, np.stack([samples[place][1] for place in first]))


def held(stream: TimedPoses, at_s: Float64[np.ndarray, " F"]) -> Float64[np.ndarray, "F 4 4"]:
    """Return poses interpolated at times; before the first and after the last pose, that pose."""
    return interpolate(stream.times_s, stream.poses, at_s.clip(stream.times_s[0], stream.times_s[-1]), 0.0)[0]
