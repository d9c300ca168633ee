"""Record scenes in CARLA, or make scenes of the logs of a car; see `--help`."""

import sys
from pathlib import Path

from omegaconf import DictConfig

from omniocc.config import build, check
from omniocc.errors import UserError
from omniocc.record.carla.recorder import CarlaRecorder
from omniocc.run.script import script


@script("record")
def main(cfg: DictConfig) -> None:
    """Check the configuration and record, or check a CARLA server."""
    check(cfg.recorder)
    recorder = build(cfg.recorder)
    if cfg.check:
        if not isinstance(recorder, CarlaRecorder):
            raise UserError("check=true asks a CARLA server: it needs recorder=carla")
        report(recorder)
        return
    scenes = recorder.record(Path(cfg.output))
    count = f"{len(scenes)} scene{'s' * (len(scenes) > 1)}"
    print(f"{cfg.output}: {count}; python src/train.py data=recorded data.source.root={cfg.output}")


def report(recorder: CarlaRecorder) -> None:
    """Print every assumption with pass or fail; exit with 1 if one fails."""
    findings = recorder.check()
    for finding in findings:
        print(f"{'pass' if finding.holds else 'FAIL'}  {finding.name} ({finding.measured})")
    failed = sum(not finding.holds for finding in findings)
    if failed:
        sys.exit(f"{failed} of {len(findings)} fail: recordings from this server would be wrong")


if __name__ == "__main__":
    main()
