"""A rig: calibrated cameras with known poses on the vehicle."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any

import torch
from jaxtyping import Bool, Float, Float32, Float64
from torch import Tensor

from omniocc.camera.calibration.fields import naming
from omniocc.camera.ops.pixels import pixel_centers, usable
from omniocc.camera.pose import check_rigid, invert_pose
from omniocc.camera.protocol import Camera
from omniocc.camera.rig_file import Calibration, read_rig, write_rig
from omniocc.images import MOST_PIXELS
from omniocc.io import checked_name, twice


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras and their poses; rigs with equal content are equal and have equal hashes, also from different files.

    Attributes:
        cameras: models of the N cameras.
        ego_from_camera: rigid poses, camera frame (x right, y down, z forward) to ego frame.
        names: unique, in the order of the cameras.
        masks: for each camera None or (height, width), true where the image is usable; None if no camera has one.
        road_z_m: height of the road below the ego origin, in the ego frame; None if it is not known.
    """

    cameras: tuple[Camera, ...]
    ego_from_camera: Float64[Tensor, "N 4 4"]
    names: tuple[str, ...]
    masks: tuple[Bool[Tensor, "_ _"] | None, ...] | None = None
    road_z_m: float | None = None

    def __post_init__(self) -> None:
        """Check the parts; raise ValueError naming the camera whose name, pose or mask is wrong."""
        count = len(self.cameras)
        if count == 0 or len(self.names) != count or self.ego_from_camera.shape != (count, 4, 4):
            raise ValueError(
                f"{count} cameras, {len(self.names)} names, poses of shape {tuple(self.ego_from_camera.shape)}: "
                "a rig needs at least one camera and one name and one 4x4 pose for each"
            )
        for name in self.names:
            checked_name("the name of a camera", name)
        if (name := twice(self.names)) is not None:
            raise ValueError(f"camera '{name}' stands twice; keep one")
        if self.masks is not None and len(self.masks) != count:
            raise ValueError(
                f"{len(self.masks)} masks for {count} cameras; give one each, None for a camera without a mask"
            )
        if self.road_z_m is not None and not -100 < self.road_z_m < 0:
            raise ValueError(f"road_z_m is {self.road_z_m}; it must be below 0, in metres: the road is below the rig")
        for index, (name, camera, mask) in enumerate(zip(self.names, self.cameras, self.each_mask, strict=True)):
            check_rigid(self.ego_from_camera[index], f"camera '{name}'")
            if camera.width * camera.height > MOST_PIXELS:
                size, most = f"{camera.width}x{camera.height} px", f"{MOST_PIXELS // 10**6} megapixels"
                raise ValueError(f"camera '{name}': its image has {size}; images of more than {most} are not read")
            if mask is not None and mask.shape != (camera.height, camera.width):
                size = f"{mask.shape[1]}x{mask.shape[0]}"
                raise ValueError(
                    f"camera '{name}': mask is {size} px but the image is {camera.width}x{camera.height} px"
                )

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Rig":
        """Read a rig file (see `omniocc.camera.rig_file`), or a built-in rig: `fisheye6`, `pinhole6`, `surround_view`.

        Calibrations of OpenCV, Kalibr, OCamCalib, KITTI-360 and OmniMVS are recognised by their content, see
        `omniocc.camera.calibration`.

        Raises:
            ValueError: naming file, the camera and the wrong value.
        """
        calibration = read_rig(path)
        with naming(str(path)):
            return cls(*calibration)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a rig file, and masks as PNG files beside it; loading it gives an equal rig."""
        write_rig(path, Calibration(self.cameras, self.ego_from_camera, self.names, self.masks, self.road_z_m))

    @property
    def each_mask(self) -> tuple[Bool[Tensor, "_ _"] | None, ...]:
        """Return the mask of every camera, None for one without."""
        return self.masks or (None,) * len(self.cameras)

    def project(
        self, points_ego: Float[Tensor, "*batch 3"]
    ) -> tuple[Float[Tensor, "N *batch 2"], Bool[Tensor, "N *batch"]]:
        """Return the pixels of ego points (m) in every camera, and where they are valid: seen by lens and mask."""
        results = [self.project_into(camera, points_ego) for camera in range(len(self.cameras))]
        return torch.stack([pixels for pixels, _ in results]), torch.stack([valid for _, valid in results])

    def rays(self, camera: int) -> tuple[Float32[Tensor, "height width 3"], Bool[Tensor, "height width"]]:
        """Return the unit ray, ego frame, of every pixel of one camera, and whether lens and mask allow it."""
        model = self.cameras[camera]
        rays, valid = model.unproject(pixel_centers(model.width, model.height, torch.float64))
        mask = self.each_mask[camera]
        rays = rays @ self.ego_from_camera[camera, :3, :3].T
        return rays.float(), valid if mask is None else valid & mask

    def resized(self, width: int, height: int) -> "Rig":
        """Return the same rig with every image scaled to `width` x `height` px."""
        cameras = tuple(camera.resized(width, height) for camera in self.cameras)
        masks = _changed(self.masks, lambda mask: _resized_mask(mask, width, height))
        return replace(self, cameras=cameras, masks=masks)

    @cached_property
    def fingerprint(self) -> str:
        """Return a hash of models, poses, names, masks and road: equal for equal rigs, in every process."""
        digest = hashlib.sha256()
        for index, (name, camera, mask) in enumerate(zip(self.names, self.cameras, self.each_mask, strict=True)):
            digest.update(f"{name}\n{camera!r}\n".encode())
            digest.update((self.ego_from_camera[index] + 0.0).numpy().tobytes())
            digest.update(b"-" if mask is None else mask.numpy().tobytes())
        if self.road_z_m is not None:
            digest.update(repr(self.road_z_m).encode())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rig) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state with arrays for tensors: between processes each tensor would need an open file."""
        masks = _changed(self.masks, Tensor.numpy)
        return self.__dict__ | {"ego_from_camera": self.ego_from_camera.numpy(), "masks": masks}

    def __setstate__(self, state: dict[str, Any]) -> None:
        poses, masks = torch.from_numpy(state["ego_from_camera"]), _changed(state["masks"], torch.from_numpy)
        self.__dict__.update(state | {"ego_from_camera": poses, "masks": masks})

    def project_into(
        self, camera: int, points_ego: Float[Tensor, "*batch 3"]
    ) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """Return the pixels of ego points (m) in one camera, and where they are valid: seen by lens and mask."""
        camera_from_ego = invert_pose(self.ego_from_camera[camera]).to(points_ego)
        x, y, z = points_ego[..., :1], points_ego[..., 1:2], points_ego[..., 2:]
        # Sums instead of a matrix product, which autocast or TF32 would round.
        right, down, forward, origin = camera_from_ego[:3].unbind(-1)
        pixels, valid = self.cameras[camera].project(x * right + y * down + z * forward + origin)
        return pixels, usable(self.each_mask[camera], pixels, valid)


def _changed(masks: Sequence[Any] | None, change: Callable[[Any], Any]) -> tuple[Any, ...] | None:
    return None if masks is None else tuple(None if mask is None else change(mask) for mask in masks)


def _resized_mask(mask: Bool[Tensor, "old_height old_width"], width: int, height: int) -> Bool[Tensor, "height width"]:
    """Return the mask at the old pixel nearest to each new pixel's centre."""
    rows = ((torch.arange(height) + 0.5) * mask.shape[0] / height).long()
    columns = ((torch.arange(width) + 0.5) * mask.shape[1] / width).long()
    return mask[rows][:, columns]
