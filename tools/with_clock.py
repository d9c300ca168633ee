"""Run pip, which is silent for minutes; show every few seconds how long it has run and how many packages are there.

`python tools/with_clock.py VENV COMMAND...`; the exit code is that of the command. On a terminal one line is
rewritten. Only the standard library is used, since nothing is installed yet.
"""

import subprocess
import sys
import time
from pathlib import Path

EVERY_S = 5.0


def main() -> int:
    """Run the command and return its exit code."""
    venv, command = Path(sys.argv[1]), sys.argv[2:]
    ends = ("\r", "\n") if sys.stdout.isatty() else ("\n", "")
    began_s = time.monotonic()
    process = subprocess.Popen(command)
    while True:
        try:
            code = process.wait(EVERY_S)
        except subprocess.TimeoutExpired:
            elapsed_s = int(time.monotonic() - began_s)
            clock = f"{elapsed_s // 60}:{elapsed_s % 60:02d} min"
            packages = len(list(venv.glob("lib/python*/site-packages/*.dist-info")))
            print(f"  {clock}: {packages} packages installed", end=ends[0], flush=True)
        except KeyboardInterrupt:
            continue  # the command has got it too, and ends
        else:
            print(end=ends[1], flush=True)
            return code


if __name__ == "__main__":
    sys.exit(main())
