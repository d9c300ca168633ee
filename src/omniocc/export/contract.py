"""Describe inputs and outputs of an exported program, for use without this package."""

from typing import Any

from omniocc.classes import ClassTable
from omniocc.export.program import FrameProgram, Step, example_inputs
from omniocc.predict.output.voxel_files import raise_grid

MEANINGS = {
    "images": "RGB 0..255 of every camera in the rig's order, rows from the top; a black image marks a missing camera",
    "past_volumes": "output `volume` of each past frame, oldest first; zeros where there is none",
    "past_exists": "whether the past frame exists",
    "world_from_ego": "poses of the past frames and, last, of this one: p_world = world_from_ego @ p_ego, metres; "
    "ego x forward, y left, z up, origin rig.ego_origin_z_m above that of the rig file; any rigid pose where a past "
    "frame does not exist",
    "labels": "class of every cell, see classes, also of those that no camera sees; axes as in grid.axes",
    "volume": "features of this frame, an entry of past_volumes for the next frames",
}
AXES = {
    "Cylinder": ["radius, metres", "azimuth, radians, from -pi counter-clockwise from x, periodic", "height, metres"],
    "Cuboid": ["x, metres", "y, metres", "z, metres"],
}


def contract_of(module: FrameProgram | Step, classes: ClassTable, height_m: float = 0.0) -> dict[str, Any]:
    """Return names, shapes, types and units of inputs and outputs, the grid, the classes and the rig, as plain data.

    Along each axis of the grid, cell i spans low + (high - low) * [i, i + 1] / shape, with (low, high) from `bounds`.
    Those bounds and the poses are in an ego frame whose origin is `height_m` above that of the rig file
    (`ego_origin_z_m`); `bounds_in_rig_file` are the same in the frame of the rig file.
    """
    model, rig = module.model, module.rig
    grid, kind = model.geometry, type(model.geometry).__name__
    names = ["images", "past_volumes", "past_exists", "world_from_ego"]
    inputs = [
        _port(name, tuple(tensor.shape), str(tensor.dtype).removeprefix("torch."))
        for name, tensor in zip(names, example_inputs(module), strict=False)
    ]
    outputs = [_port("labels", grid.shape, "uint8")]
    if isinstance(module, Step):
        outputs.append(_port("volume", (model.lifter.channels, *grid.shape), "float32"))
    camera = rig.cameras[0]
    return {
        "inputs": inputs,
        "outputs": outputs,
        "frames": model.temporal.frames,
        "rig": {
            "cameras": list(rig.names),
            "image_size_px": [camera.width, camera.height],
            "fingerprint": rig.fingerprint,
            "ego_origin_z_m": height_m,
        },
        "grid": {
            "kind": kind,
            "axes": AXES[kind],
            "shape": list(grid.shape),
            "bounds": [list(ends) for ends in grid.bounds],
            "bounds_in_rig_file": [list(ends) for ends in raise_grid(grid, height_m).bounds],
        },
        "occupied_above": module.occupied_above,
        "classes": list(classes.names),
    }


def _port(name: str, shape: tuple[int, ...], dtype: str) -> dict[str, Any]:
    return {"name": name, "shape": list(shape), "dtype": dtype, "meaning": MEANINGS[name]}
