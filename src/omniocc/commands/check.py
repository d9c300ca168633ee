"""Read a dataset back and list all that is wrong with it: `python src/check.py data=... data.source.root=...`."""

import argparse
import sys
from pathlib import Path

from omniocc.config import check_root
from omniocc.parallel import usable_cores
from omniocc.parts import Parts
from omniocc.runs.script import lines_not_tracebacks, quiet_libraries, train_config


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
    check_root(cfg := train_config(options.overrides))
    parts = Parts(cfg)
    from omniocc.check import read_back

    quiet_libraries()
    problems = read_back(parts.data(), options.frames, options.workers, options.draw)
    sys.exit(f"{problems} problem{'s' * (problems > 1)}") if problems else print("no problems")


if __name__ == "__main__":
    main()
