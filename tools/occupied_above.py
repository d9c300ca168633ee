"""Score a checkpoint by the probability above which a cell is occupied: `python tools/occupied_above.py any-rig`.

The scenes are those of the checkpoint's data, of the validation unless `--split test` is given; missing ones are
rendered. Frames are predicted with the history that `predict.py occupancy` gives them.
"""

import argparse
from functools import partial

import torch
from jaxtyping import Float16, UInt8
from torch import Tensor

from omniocc.errors import UserError
from omniocc.predict import load
from omniocc.predict.input.sequence import RecordedSequence
from omniocc.predict.options import choose_device
from omniocc.predict.predictor import Predictor
from omniocc.progress import Progress
from omniocc.report.card import BANDS
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries
from omniocc.runs.table import in_columns, number
from omniocc.scores import Scores

ABOVE = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6)
MOST_LIKELY = "most likely class"


def labels_by_rule(
    classes: UInt8[Tensor, "X Y Z"], probability: Float16[Tensor, "2 X Y Z"]
) -> dict[str, UInt8[Tensor, "X Y Z"]]:
    """Return the labels by every rule, given the most likely class but free of every cell."""
    occupied, of_class = probability.float()
    rules = {f"{above:g}": occupied > above for above in ABOVE}
    rules[MOST_LIKELY] = occupied * of_class > 1 - occupied
    return {rule: classes.where(chosen, 0) for rule, chosen in rules.items()}


@lines_not_tracebacks
def main(words: list[str] | None = None) -> None:
    """Print a table with a row for each rule."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", help="file, folder of a run, or name of shipped weights")
    parser.add_argument("overrides", nargs="*", help="changes of its configuration, such as data.source.val_scenes=8")
    parser.add_argument("--split", choices=("val", "test"), default="val")
    given = parser.parse_args(words)
    quiet_libraries()
    trained = load(given.checkpoint, given.overrides)
    source, model = trained.data.source, trained.occupancy
    if not hasattr(source, "planned"):
        raise UserError(f"{trained.path}: its data are not of the virtual world")
    scenes = source.made(given.split, list(source.planned(given.split)))  # type: ignore[union-attr]
    scores = {rule: Scores(model.geometry, trained.data.spec) for rule in (MOST_LIKELY, *map("{:g}".format, ABOVE))}
    predictor = Predictor(model, None, (), choose_device(None), occupied_above=0.0)
    with Progress(f"predicting {given.split} scenes", sum(map(len, scenes))) as progress:
        for scene in scenes:
            sequence = RecordedSequence(scene, tuple(range(len(scene))))
            predictor.image_width = trained.facts.width_for(sequence.rig)
            history = "stream" if model.temporal.frames > 1 else "none"
            for frame, _, found, _ in predictor.frames(sequence.wanted, history, partial(predictor.read, sequence)):
                truth = sequence.truth(frame, model.geometry, trained.data.ignore)
                for rule, labels in labels_by_rule(found.labels, found.probability).items():
                    scores[rule].update(labels[None], truth)
                progress.advance()
    print(table(scores))


def table(scores: dict[str, Scores]) -> str:
    """Return the scores as text."""
    keys = ["rayiou", *(f"rayiou_{band}" for band in BANDS), "lidar/rayiou", "voxel/iou", "voxel/miou"]
    rows = []
    for rule, one in scores.items():
        figures = {key: float(value) for key, value in one.compute().items()}
        rows.append([rule, *(number(figures.get(key)) for key in keys)])
    return in_columns(["occupied above", *keys], rows)


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
