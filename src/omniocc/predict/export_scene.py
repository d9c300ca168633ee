"""A recorded scene as pictures of a user's own would be: `python -m omniocc.predict.export SCENE FOLDER`."""

import argparse
from pathlib import Path

import cv2
import torch

from omniocc.config import lines_not_tracebacks
from omniocc.data import SceneReader
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.predict.input.poses import write_poses
from omniocc.predict.input.sequence import RecordedDrive

RIG, POSES = "rig.yaml", "poses.csv"


def export_scene(scene: Path, folder: Path) -> int:
    """Writes `<frame>/<camera>.png`, `rig.yaml` and `poses.csv`; no pixel changes, and no bit of a pose.

    Args:
        scene: folder of a recorded scene.
        folder: made if missing.

    Returns:
        how many frames there are.

    Raises:
        UserError: when there is no scene.
        OSError: when something is damaged or cannot be written.
    """
    if not (scene / META).is_file():
        raise UserError(f"{scene} is no recorded scene; give one such as data/virtual-<hash>/test-000-downtown")
    reader = SceneReader(scene)
    drive = RecordedDrive(reader, tuple(range(len(reader))))
    folder.mkdir(parents=True, exist_ok=True)
    drive.rig.save(folder / RIG)
    write_poses(folder / POSES, drive.moments, torch.as_tensor(drive.world_from_ego))
    for k, moment in enumerate(drive.moments):
        (folder / moment).mkdir(exist_ok=True)
        for name, image in zip(drive.rig.names, drive.images(k), strict=True):
            done, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
            assert done
            (folder / moment / f"{name}.png").write_bytes(content.tobytes())
    return len(drive.moments)


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m omniocc.predict.export", description=__doc__)
    parser.add_argument("scene", type=Path, help="folder of a recorded scene: data/virtual-<hash>/<scene>")
    parser.add_argument("folder", type=Path, help=f"to write <frame>/<camera>.png, {RIG} and {POSES} into")
    options = parser.parse_args(arguments)
    frames = export_scene(options.scene, options.folder)
    print(f"{options.folder}: {frames} moments, {RIG}, {POSES}")


if __name__ == "__main__":
    main()
