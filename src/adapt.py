"""Train the weights in the package further for your own cameras: `python src/adapt.py rig=my_rig.yaml minutes=30`.

Streets of the virtual world are rendered as your cameras see them, sketch and voxels are trained on them, starting from
the weights 'any-rig', and tested on streets that they never saw. At the end stand a table (baseline, these weights as
they are, adapted, upper bound) and the command that predicts with the result. The same command goes on after a stop.

python src/adapt.py rig=my_rig.yaml minutes=30 plan=true                               only what it would do
python src/adapt.py rig=my_rig.yaml minutes=90 model/backbone=efficientnet_lite0       any key of src/train.py
python src/adapt.py data=recorded data.source.root=my_scenes minutes=30                own recordings with LiDAR
"""

import argparse

from omniocc.adapt import adapt
from omniocc.errors import UserError
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries


@lines_not_tracebacks
def main() -> None:
    """Read the words of the command line, and adapt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="+", metavar="key=value", help="rig, minutes, or a key of src/train.py")
    words = dict(word.split("=", 1) if "=" in word else (word, "") for word in parser.parse_args().words)
    rig, minutes = words.pop("rig", None), words.pop("minutes", "30")
    try:
        seconds = 60 * float(minutes)
    except ValueError as error:
        raise UserError(f"minutes={minutes}: give a number") from error
    quiet_libraries()
    adapt(rig, seconds / 60, [f"{key}={value}" for key, value in words.items()])


if __name__ == "__main__":
    main()
