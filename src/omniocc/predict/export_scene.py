"""Write a recorded scene in the form of a user's own images: `python -m omniocc.predict.export_scene SCENE FOLDER`."""

import argparse
from dataclasses import replace
from pathlib import Path

import torch

from omniocc.data import SceneReader
from omniocc.data.store.shard import META
from omniocc.draw.canvas import encode_image
from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.predict.input.poses import write_poses
from omniocc.predict.input.sequence import RecordedSequence
from omniocc.runs.script import lines_not_tracebacks

RIG, POSES = "rig.yaml", "poses.csv"


def export_scene(scene: Path, folder: Path) -> int:
    """Write `<frame>/<camera>.png`, `rig.yaml` and `poses.csv` of a recorded scene, without any loss.

    The rig states the height of the road where the scene does. The folder is created if it is missing; the number of
    frames is returned.

    Raises:
        UserError: when there is no scene.
        OSError: when a file is damaged or cannot be written.
    """
    if not (scene / META).is_file():
        raise UserError(f"{scene} is not a recorded scene; give one such as data/virtual-<hash>/test-000-downtown")
    reader = SceneReader(scene)
    sequence = RecordedSequence(reader, tuple(range(len(reader))))
    replace(sequence.rig, road_z_m=sequence.road_z_m).save(folder / RIG)
    write_poses(folder / POSES, sequence.frame_names, torch.as_tensor(sequence.world_from_ego))
    for k, frame in enumerate(sequence.frame_names):
        for name, image in zip(sequence.rig.names, sequence.images(k), strict=True):
            atomic_write(folder / frame / f"{name}.png", encode_image(image, "png"))
    return len(sequence.frame_names)


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m omniocc.predict.export_scene", description=__doc__)
    parser.add_argument("scene", type=Path, help="folder of a recorded scene: data/virtual-<hash>/<scene>")
    parser.add_argument("folder", type=Path, help=f"folder to write <frame>/<camera>.png, {RIG} and {POSES} into")
    options = parser.parse_args(arguments)
    frames = export_scene(options.scene, options.folder)
    print(f"{options.folder}: {frames} frames, {RIG}, {POSES}")


if __name__ == "__main__":
    main()
