"""Train the weights in the package further for your own cameras: `python src/adapt.py rig=my_rig.yaml minutes=30`.

Streets of the virtual world are rendered as your cameras see them, sketch and voxels are trained on them, starting from
the weights 'any-rig', and tested on streets that they never saw. At the end stand a table (baseline, these weights as
they are, adapted, upper bound) and the command that predicts with the result. The same command goes on after a stop.

python src/adapt.py rig=my_rig.yaml minutes=30 plan=true                               only what it would do
python src/adapt.py rig=camchain.yaml road_z_m=-1.4 minutes=30                         a file without the road's height
python src/adapt.py rig=my_rig.yaml minutes=90 model/backbone=efficientnet_lite0       any key of src/train.py
python src/adapt.py data=recorded data.source.root=my_scenes minutes=30                own recordings with LiDAR
"""

import argparse
from difflib import get_close_matches

from omniocc.errors import UserError
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries

OWN = ("rig", "road_z_m", "minutes")
"""Keys that `src/train.py` does not have."""


@lines_not_tracebacks
def main() -> None:
    """Read the words of the command line, and adapt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="+", metavar="key=value", help=f"{', '.join(OWN)}, or a key of src/train.py")
    words = dict(word.split("=", 1) if "=" in word else (word, "") for word in parser.parse_args().words)
    for key in words.keys() - OWN:
        if close := get_close_matches(key, OWN, n=1):
            raise UserError(f"{key}: there is no such key; did you mean {close[0]}?")
    rig, road_z_m, minutes = words.pop("rig", None), words.pop("road_z_m", None), words.pop("minutes", "30")
    height_m = None if road_z_m is None else number("road_z_m", road_z_m)
    within = number("minutes", minutes)
    from omniocc.adapt import adapt

    quiet_libraries()
    adapt(rig, height_m, within, [f"{key}={value}" for key, value in words.items()])


def number(key: str, text: str) -> float:
    """Return a number from the command line; raise UserError naming the key if it is none."""
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{key}={text}: give a number") from error


if __name__ == "__main__":
    main()
