"""Read a dataset back and list all that is wrong with it: `python src/check.py data=... data.source.root=...`."""

import argparse
import sys
from pathlib import Path

from omniocc.config import compose_config
from omniocc.data import OccupancyData
from omniocc.data.check_source import check_source, frames_of, has_labels
from omniocc.data.recording.pool import usable_cores
from omniocc.data.source import SPLITS
from omniocc.errors import DataError
from omniocc.parts import Parts
from omniocc.run.script import lines_not_tracebacks, quiet_libraries
from omniocc.view import save_png
from omniocc.view.data_sheet import data_sheet


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Build the data that the overrides choose, read its frames, print all problems, and draw some frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("overrides", nargs="+", help="those of train.py: data=occ3d_nuscenes data.source.root=...")
    parser.add_argument("--frames", type=int, default=0, help="frames of each scene to read, evenly spread (0: all)")
    parser.add_argument("--workers", type=int, default=usable_cores(), help="processes that read; 0: none besides this")
    parser.add_argument("--draw", type=Path, help="folder for an image of the first frame of every split")
    options = parser.parse_intermixed_args(arguments)
    if min(options.frames, options.workers) < 0:
        parser.error("--frames and --workers must be 0 or more")
    quiet_libraries()
    data = Parts(compose_config(Path(__file__).parents[1] / "conf", "train", options.overrides)).data()
    data.source.prepare()
    for split in SPLITS:
        scenes = data.source.scenes(split)
        print(f"{split:5}  {len(scenes)} scenes, {sum(map(frames_of, scenes))} frames", flush=True)
    names = data.spec.classes.names
    print(f"{len(names)} classes: {', '.join(names)}; train with data.num_classes={len(names)}")
    for scene in (scene for split in SPLITS for scene in data.source.scenes(split) if not has_labels(scene)):
        print(f"{scene.name} has no LiDAR: it serves prediction, not training")
    if options.draw is not None:
        draw(data, options.draw)
    problems = 0
    for problem in check_source(data.source, data.geometry, options.frames, options.workers):
        problems += 1
        print(problem, flush=True)
    if problems:
        sys.exit(f"{problems} problem{'s' * (problems > 1)}")
    print("no problems")


def draw(data: OccupancyData, folder: Path) -> None:
    """Draw the first frame of every split: ranges on the images, voxels; name the one that cannot be read."""
    benchmark, classes = data.spec.benchmark, data.spec.classes
    grid = data.geometry if benchmark is None else benchmark.grid
    labels = data.source.labels(grid, "free")
    for split in SPLITS:
        for scene in data.source.scenes(split)[:1]:
            known = has_labels(scene)
            try:
                if known:
                    labels.prepare([scene])
                parts = scene.images(0), scene.rigs[0], scene.camera_range_m(0), scene.erp_range_m(0)
                voxels = labels.read(scene, 0) if known else None
            except (DataError, ValueError) as error:
                print(f"the first frame of {split} cannot be drawn: {error}", flush=True)
                continue
            path = folder / f"{split}-{scene.name}.png"
            save_png(path, data_sheet(*parts, voxels, grid, classes, f"{split}: {scene.name}, frame 0"))
            print(f"image    {path}", flush=True)


if __name__ == "__main__":
    main()
