"""Options of `predict.py occupancy`, and those that several commands share: rig, device."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from omniocc.bounds import Probability
from omniocc.camera import Rig
from omniocc.errors import UserError, first_line
from omniocc.predict.input.schedule import History


@dataclass(frozen=True)
class Options:
    """Options of `predict.py occupancy`; see `conf/predict_occupancy.yaml`."""

    checkpoint: str
    images: str | Sequence[str] | None
    rig: str | None
    poses: str | None
    road_z_m: float | None
    recorded: str | None
    scene: str | None
    frames: Sequence[int] | None
    history: History | None
    output: str
    force: bool
    overview: bool
    mesh: bool
    exclude_cameras: Sequence[str]
    image_width: int | None
    device: str | None
    viewer: str | None = None
    image_bits: int | None = None
    topics: str | None = None
    write_bag: str | None = None
    occupied_above: Probability | None = None  # pyright: ignore[reportOperatorIssue]


def load_rig(source: str) -> Rig:
    """Return the rig of a rig file, a calibration file or a built-in name.

    Raises:
        UserError: when it cannot be used.
    """
    try:
        return Rig.load(source)
    except ValueError as error:
        text = str(error)
        raise UserError(f"rig={text}" if text.startswith(f"{source}: ") else f"rig={source}: {text}") from error


def choose_device(name: str | None) -> torch.device:
    """Return the named device; None: the GPU if there is one, else the CPU.

    Raises:
        UserError: when the device is not available.
    """
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UserError(f"device={name}: {first_line(error)}; use cpu or cuda") from error
    return device
