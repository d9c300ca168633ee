"""Disk space of scenes, estimated before they are rendered."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from omniocc.errors import DataError
from omniworld.source import ScenePlan, VirtualWorld

OTHER_BYTES = 45_000
"""Size of ego LiDAR, poses and boxes, tar headers and the frame's lines in the index."""
GEOMETRY_BYTES = 800_000
RIGS = 20
"""Drawn rigs over which the size is averaged."""


def frame_bytes(world: VirtualWorld) -> int:
    """Return the mean size of a recorded frame in bytes, by power laws fitted to frames of all eight places.

    Measured, in kB: 4.9, 35.4, 105.7, 325 for a camera of 64x36, 256x144, 512x288, 1024x576 px; 0.7, 5.4, 40.7 for a
    panorama of 48x12, 180x45, 720x180 px; 51, 137, 207, 318, 475 for points of 1, 5, 10, 20, 40 LiDARs. Places differ
    by 15 percent.
    """
    rigs = [world.rig_of(plan) for plan in world.plans[:RIGS]] if world.rig is None else [world.rig]
    cameras = sum(8.73 * (camera.width * camera.height) ** 0.79 for rig in rigs for camera in rig.cameras) / len(rigs)
    panorama = 5.96 * (world.erp_size[0] * world.erp_size[1]) ** 0.75
    points = GEOMETRY_BYTES if world.label_mode == "geometry" else 318_000 * (world.lidars / 20) ** 0.6
    return round(cameras + panorama + points + OTHER_BYTES)


def half_recorded(world: VirtualWorld, missing: Sequence[ScenePlan]) -> list[Path]:
    """Return the folders in which an interrupted run has left frames of these scenes."""
    folders = [world.folder / f"{plan.name}.partial" for plan in missing]
    return [folder for folder in folders if folder.is_dir()]


def bytes_to_come(world: VirtualWorld, missing: Sequence[ScenePlan]) -> int:
    """Return the number of bytes that rendering these scenes will still write after an interrupted run."""
    written = sum(path.stat().st_size for folder in half_recorded(world, missing) for path in folder.glob("*.tar"))
    return max(0, len(missing) * world.frames_per_scene * frame_bytes(world) - written)


def announcement(world: VirtualWorld, plans: Sequence[ScenePlan]) -> str:
    """Return a line about the scenes that a run will render, the disk space they take and the free space.

    Raises:
        DataError: when the disk has less space than the scenes will take.
    """
    missing = world.missing(plans)
    if not missing:
        return f"{world.place}: all {len(plans)} scenes exist"
    frames, needed = len(missing) * world.frames_per_scene, bytes_to_come(world, missing)
    free = shutil.disk_usage(existing(world.folder)).free
    if needed > free:
        raise DataError(
            f"{world.place}: {len(missing)} scenes of {world.frames_per_scene} frames take about {size(needed)}, the "
            f"disk has {size(free)} free: free some space, choose another folder (paths.data=...), or render fewer "
            f"scenes (scenes=...); nothing was written"
        )
    complete = f", {len(plans) - len(missing)} exist" if len(missing) < len(plans) else ""
    return (
        f"{world.place}: {len(missing)} of {len(plans)} scenes to render{complete}, {frames:,} frames, about "
        f"{size(needed)}, {size(free)} free"
    )


def existing(folder: Path) -> Path:
    """Return the folder, or the nearest folder above it that exists."""
    return next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())


def size(count: int) -> str:
    """Return a number of bytes in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
