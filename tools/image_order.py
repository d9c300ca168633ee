"""Count how often images in the wrong order are told: `python tools/image_order.py FOLDER...` of recorded scenes.

Of every scene the first frame is taken. A false alarm is a warning about the correct order, once for the images as they
are and once with other gains of each camera and colour (0.6 to 1.4) and noise (8 of 255). Then each two images are
swapped.
"""

import sys
from itertools import combinations
from pathlib import Path

import numpy as np

from omniocc.camera import Rig
from omniocc.camera.seams import MOST_CAMERAS, Seams, best_order, better_order, measure_seams
from omniocc.data import SceneReader
from omniocc.data.store.shard import META


def swaps(seams: dict[tuple[int, int], Seams], kinds: list[tuple[int, ...]]) -> list[tuple[bool, bool]]:
    """Return for each swap of two images whether a warning comes, and whether it names the correct order."""
    found = []
    for one, other in combinations(range(len(kinds)), 2):
        order = list(range(len(kinds)))
        order[one], order[other] = other, one
        swapped = {key: seam._replace(fits=seam.fits[np.ix_(order, order)]) for key, seam in seams.items()}
        better = best_order(swapped, kinds)
        found.append((better is not None, better is not None and [order[k] for k in better] == sorted(order)))
    return found


def disturbed(images: list[np.ndarray], rng: np.random.Generator) -> list[np.ndarray]:
    """Return images with other gains and noise."""
    values = [image * rng.uniform(0.6, 1.4, 3) + rng.normal(0, 8, image.shape) for image in images]
    return [value.clip(0, 255).astype(np.uint8) for value in values]


def main(folders: list[str]) -> None:
    """Print a line for each folder."""
    rng = np.random.default_rng(0)
    for folder in folders:
        scenes, alarms, found = 0, 0, []
        for scene in sorted(path.parent for path in Path(folder).glob(f"*/{META}")):
            reader = SceneReader(scene)
            rig: Rig = reader.rig
            images = [np.asarray(image) for image in reader.images(0)]
            if 1 < len(images) <= MOST_CAMERAS and (seams := measure_seams(images, rig)):
                kinds = [image.shape for image in images]
                scenes += 1
                alarms += (best_order(seams, kinds) is not None) + (
                    better_order(disturbed(images, rng), rig) is not None
                )
                found += swaps(seams, kinds)
        told, right = np.sum(found, axis=0) if found else (0, 0)
        print(
            f"{folder}: {scenes} scenes with an overlap, {alarms} false alarms in {2 * scenes}; of {len(found)} swaps "
            f"{told} told, {right} with the correct order"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
