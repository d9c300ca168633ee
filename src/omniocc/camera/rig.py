"""A rig: calibrated cameras with known poses on the vehicle, and its file, one YAML per rig.

    road_z_m: -2.2                            # optional, m, height of the road in the rig's frame
    cameras:
      front:
        model: equidistant                    # a key of MODELS below
        width: 512                            # then the parameters of the model, by name
        height: 288
        focal_px: 154.4
        center_px: [255.5, 143.5]
        max_angle_deg: 95.0
        ego_from_camera: {position_m: [0.9, 0, 0], yaw_deg: 0, pitch_deg: -10, roll_deg: 0}
        mask: front.png                       # optional, relative to this file; not 0 where the image is usable
      rear:
        calibration: rear_opencv.yaml         # or, in place of model and parameters, a calibration file of one camera
        ego_from_camera: {position_m: [-0.9, 0, 0], yaw_deg: 180, pitch_deg: -10, roll_deg: 0}

Angles are those of `omniocc.camera.pose.pose_from_angles`. `ego_from_camera` may also be the four rows of a 4x4 matrix.
`Rig.save` writes those, as angles would not reproduce a calibrated pose to the last bit.
"""

import dataclasses
import difflib
import hashlib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import yaml
from jaxtyping import Bool, Float, Float32, Float64
from torch import Tensor

from omniocc.camera.calibration import Calibration, parse, read_calibration, read_calibration_folder
from omniocc.camera.calibration.fields import mapping, naming, read_mask_of
from omniocc.camera.models.double_sphere import DoubleSphere
from omniocc.camera.models.equidistant import Equidistant
from omniocc.camera.models.eucm import EUCM
from omniocc.camera.models.ftheta import FTheta
from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.models.mei import MEI
from omniocc.camera.models.ocam import OCam
from omniocc.camera.models.panoramic import Panoramic
from omniocc.camera.models.pinhole import Pinhole
from omniocc.camera.models.radial_polynomial import RadialPolynomial
from omniocc.camera.ops.pixels import pixel_centers, usable
from omniocc.camera.pose import check_rigid, check_road, invert_pose, pose_from_angles
from omniocc.camera.protocol import Camera, finite, numbers
from omniocc.errors import repr_of
from omniocc.images import MOST_PIXELS
from omniocc.io import atomic_write, checked_name, read_short_text, twice

MODELS = {
    "equidistant": Equidistant,
    "pinhole": Pinhole,
    "kannala_brandt": KannalaBrandt,
    "mei": MEI,
    "ocam": OCam,
    "double_sphere": DoubleSphere,
    "eucm": EUCM,
    "radial_polynomial": RadialPolynomial,
    "ftheta": FTheta,
    "panoramic": Panoramic,
}
BUILT_IN = Path(__file__).parent / "rigs"
MAX_CAMERAS = 100
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")

Mask = Bool[Tensor, "_ _"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras and their poses; rigs with equal content are equal and have equal hashes, also from different files.

    Attributes:
        cameras: models of the N cameras.
        ego_from_camera: rigid poses, camera frame (x right, y down, z forward) to ego frame.
        names: unique, in the order of the cameras.
        masks: for each camera None or (height, width), true where the image is usable; None if no camera has one.
        road_z_m: z of the road in the ego frame, m, negative as it is below the origin; None if it is not known.
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
        check_road(self.road_z_m)
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
        """Read a rig file (see `omniocc.camera.rig`), or a built-in rig: `fisheye6`, `pinhole6`, `surround_view`.

        Calibrations of OpenCV, Kalibr, OCamCalib, KITTI-360, OmniMVS and NVIDIA (NCore, DriveWorks) are recognised by
        their content, see `omniocc.camera.calibration`.

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
        return self._with_sizes([(width, height)] * len(self.cameras))

    def scaled(self, factor: float) -> "Rig":
        """Return the same rig with every image about `factor` times as wide, with the same ratio of width to height.

        Even sizes stay even. Images whose width and height have a large common divisor come nearest to the factor.
        """
        divisors = [math.gcd(camera.width, camera.height) for camera in self.cameras]
        parts = [divisor if divisor % 2 else divisor // 2 for divisor in divisors]
        steps = [max(1, round(factor * part)) for part in parts]
        scales = zip(self.cameras, parts, steps, strict=True)
        return self._with_sizes([(c.width // part * step, c.height // part * step) for c, part, step in scales])

    def _with_sizes(self, sizes: Sequence[tuple[int, int]]) -> "Rig":
        cameras = tuple(camera.resized(*size) for camera, size in zip(self.cameras, sizes, strict=True))
        pairs = zip(self.each_mask, sizes, strict=True)
        masks = tuple(None if mask is None else _resized_mask(mask, *size) for mask, size in pairs)
        return replace(self, cameras=cameras, masks=None if self.masks is None else masks)

    def raised(self, height_m: float) -> "Rig":
        """Return the same cameras in an ego frame whose origin is `height_m` higher."""
        poses = self.ego_from_camera.clone()
        poses[:, 2, 3] -= height_m
        road_z_m = None if self.road_z_m is None else self.road_z_m - height_m
        return replace(self, ego_from_camera=poses, road_z_m=road_z_m)

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


def read_rig(path: str | PathLike[str], within: Sequence[Path] = ()) -> Calibration:
    """Return the arguments of `Rig`; `within` are the rig files that name this one as a calibration.

    Raises:
        ValueError: naming the file, the camera and the wrong value.
    """
    file: Path | Calibration = _find(path)
    if file.is_dir():
        file = read_calibration_folder(file)
    if isinstance(file, Calibration):
        return file
    with naming(str(file)):
        text = read_short_text(file)
        content = parse(text)
        if not isinstance(content, dict) or isinstance(content.get("cameras", []), list):
            return read_calibration(file, text, content)
        _check_keys(content, ["cameras"], ["road_z_m"])
        road_z_m = None if content.get("road_z_m") is None else finite("road_z_m", content["road_z_m"])
        entries = mapping(content["cameras"], "'cameras'")
        if len(entries) > MAX_CAMERAS:
            raise ValueError(f"'cameras' has {len(entries):,} entries; at most {MAX_CAMERAS} are read")
        for name in entries:  # YAML reads 007 as 7 and on as True
            if not isinstance(name, str) and not re.search(rf"(?<![\w.+-]){name}\s*:", text):
                raise ValueError(f"the name of a camera reads as {name!r}; write it in quotes")
        names = tuple(checked_name("the name of a camera", str(name)) for name in entries)
    read = [_read_entry([*within, file], name, entry) for name, entry in zip(names, entries.values(), strict=True)]
    cameras, poses, masks = zip(*read, strict=True)
    known = None if all(mask is None for mask in masks) else masks
    return Calibration(cameras, torch.stack(poses), names, known, road_z_m)


def write_rig(path: str | PathLike[str], rig: Calibration) -> None:
    """Write a rig file; see `Rig.save`; raise DataError naming the file that cannot be written."""
    file = Path(path)
    model_names = {model: name for name, model in MODELS.items()}
    entries = {}
    for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        parameters = {key: list(v) if isinstance(v, tuple) else v for key, v in vars(camera).items()}
        entry = {
            "model": model_names[type(camera)],
            **parameters,
            "ego_from_camera": rig.ego_from_camera[index].tolist(),
        }
        mask = None if rig.masks is None else rig.masks[index]
        if mask is not None:
            entry["mask"] = f"{file.stem}.{name}.png"
            _, png = cv2.imencode(".png", mask.numpy().astype(np.uint8) * 255)
            atomic_write(file.parent / entry["mask"], png.tobytes())
        entries[name] = entry
    road = {} if rig.road_z_m is None else {"road_z_m": rig.road_z_m}
    atomic_write(file, yaml.safe_dump(road | {"cameras": entries}, sort_keys=False, default_flow_style=None))


def _read_entry(files: Sequence[Path], name: str, entry: Any) -> tuple[Camera, Float64[Tensor, "4 4"], Mask | None]:
    file = files[-1]
    with naming(f"{file}: camera '{name}'"):
        camera, mask = _read_camera(files, mapping(entry, "its entry"))
        pose = _read_pose(entry["ego_from_camera"])
        if entry.get("mask") is None:
            return camera, pose, mask
        return camera, pose, read_mask_of("mask", file.parent / str(entry["mask"]), camera)


def _find(path: str | PathLike[str]) -> Path:
    built_in = {file.stem: file for file in sorted(BUILT_IN.glob("*.yaml"))}
    if str(path) in built_in:
        return built_in[str(path)]
    if not Path(path).exists():
        hint = _did_you_mean(str(path), list(built_in))
        raise ValueError(f"no rig file '{path}'{hint}; built-in rigs: {', '.join(built_in)}")
    return Path(path)


def _read_camera(files: Sequence[Path], entry: dict[str, Any]) -> tuple[Camera, Mask | None]:
    """Return the lens of an entry, and the mask that the file of another tool has for it."""
    if "calibration" in entry:
        _check_keys(entry, ["calibration", "ego_from_camera"], ["mask"])
        file = files[-1].parent / str(entry["calibration"])
        if not file.is_file() and not file.is_dir():
            raise ValueError(f"calibration {file} does not exist, or is a device or pipe")
        if file.resolve() in [other.resolve() for other in files]:
            raise ValueError(f"calibration {file} leads back to itself; name a file with lens and size of the image")
        found = read_rig(file, files)
        if len(found.cameras) != 1:
            raise ValueError(f"calibration {entry['calibration']} holds {len(found.cameras)} cameras; it must be one")
        return found.cameras[0], None if found.masks is None else found.masks[0]
    if "model" not in entry:
        raise ValueError(f"it has neither a model ({', '.join(MODELS)}) nor a calibration, the file of another tool")
    name = entry["model"]
    if not isinstance(name, str) or name not in MODELS:
        raise ValueError(f"unknown model '{name}'{_did_you_mean(str(name), list(MODELS))}; models: {', '.join(MODELS)}")
    model = MODELS[name]
    parameters = [field.name for field in dataclasses.fields(model)]
    _check_keys(entry, ["model", *parameters, "ego_from_camera"], ["mask"])
    return model(**{key: _parameter(key, entry[key]) for key in parameters}), None


def _parameter(key: str, value: Any) -> Any:
    if key in ("width", "height"):
        return value
    return tuple(finite(key, number) for number in value) if isinstance(value, list) else finite(key, value)


def _read_pose(value: Any) -> Float64[Tensor, "4 4"]:
    if isinstance(value, dict):
        _check_keys(value, ["position_m", *ANGLES], [], "ego_from_camera.")
        x, y, z = numbers("ego_from_camera.position_m", value["position_m"], 3, 3)
        yaw, pitch, roll = (finite(f"ego_from_camera.{key}", value[key]) for key in ANGLES)
        return pose_from_angles((x, y, z), yaw, pitch, roll)
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError(
            f"ego_from_camera is {repr_of(value)}; give position_m, {', '.join(ANGLES)}, or four rows of 4 numbers"
        )
    rows = [numbers("a row of ego_from_camera", row, 4, 4) for row in value]
    pose = torch.tensor(rows, dtype=torch.float64)
    check_rigid(pose, "its pose")
    return pose


def _check_keys(entry: dict[str, Any], required: list[str], optional: list[str], prefix: str = "") -> None:
    known = required + optional
    if missing := [f"{prefix}{key}" for key in required if key not in entry]:
        needed = ", ".join(required) + "".join(f", {key} (optional)" for key in optional)
        raise ValueError(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing; keys: {needed}")
    for key in entry:
        if key not in known:
            raise ValueError(f"unknown key {prefix}{key}{_did_you_mean(str(key), known)}; keys: {', '.join(known)}")


def _did_you_mean(word: str, choices: list[str]) -> str:
    close = difflib.get_close_matches(word, choices, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""
