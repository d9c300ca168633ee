"""Test a checkpoint again, find what breaks it, or score predictions of any project in a benchmark's format.

python src/evaluate.py runs/demo-.../best.ckpt [key=value ...]
python src/evaluate.py runs/*/best.ckpt --origins trajectory
python src/evaluate.py runs/ours-.../best.ckpt runs/bevdet-.../best.ckpt robustness=all
python src/evaluate.py tiny robustness=[camera_dropped,view_180_deg,extrinsics_deg]
python src/evaluate.py predictions=folder data=occ3d_nuscenes data.source.root=...

Robustness: the same test scenes are scored with something wrong, part by part; each finished part is kept, so that the
same command goes on after a stop. A word names one part (view_180_deg) or all of a kind (view):
"""

import argparse
import textwrap
from pathlib import Path

from omniocc.runs.script import lines_not_tracebacks, quiet_libraries

# Help is shown without importing what runs, so these are written again.
ORIGINS = ("own", "ego", "trajectory")
"""Choices of `omniocc.data.origins.Origins`."""
KINDS = (
    *("camera_dropped", "two_cameras_dropped", "view", "extrinsics_deg", "extrinsics_cm", "focal", "exposure", "noise"),
    *("blur", "jpeg", "drops_on_one_lens", "dirt_on_one_lens", "camera_late", "weather", "night"),
    "places_never_trained_on",
)
"""Groups of `omniocc.extras.robustness.parts.parts_of` for three cameras and unseen places."""


def parser_of() -> argparse.ArgumentParser:
    """Return the parser of the command line, whose help lists the kinds of disturbances."""
    about = "\n".join([__doc__ or "", *textwrap.wrap(", ".join(KINDS), 110)])
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = "file written by train.py, name of shipped weights, predictions=folder, robustness=..., or key=value"
    parser.add_argument("words", nargs="+", metavar="word", help=f"{what} such as data.batch_size=1")
    where = "folder of results (default: evaluation-<checkpoint>, or robustness-<checkpoint>, beside it)"
    parser.add_argument("--output", type=Path, help=where)
    rays = "where rays of RayIoU start: own (the dataset's protocol, else the ego origin: the default), ego, or "
    rays += "trajectory (where the car was in past, present and future frames, scored apart as well)"
    parser.add_argument("--origins", choices=ORIGINS, default="own", help=rays)
    parser.add_argument("--images", type=int, default=4, help="test frames to draw (default: 4)")
    parser.add_argument("--audit", action="store_true", help="only print where the score is lost, on validation scenes")
    parser.add_argument("--scenes", type=int, default=8, help="robustness: test scenes, the first ones (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="robustness: of what is drawn at random (default: 0)")
    return parser


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Score what the words name; results are written beside the checkpoints."""
    parser = parser_of()
    options = vars(parser.parse_intermixed_args(arguments))
    from omniocc.evaluate import Evaluation
    from omniocc.extras.robustness.evaluation import score_robustness

    asked = Evaluation.from_words(options.pop("words"), **options)
    if asked.conflict is not None:
        parser.error(asked.conflict)
    quiet_libraries()
    asked.run() if asked.robustness is None else score_robustness(asked)


if __name__ == "__main__":
    main()
