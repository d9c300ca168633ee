"""Record scenes in CARLA, or make scenes of the logs of a car; see `--help`."""

import sys
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from omniocc.config import check
from omniocc.errors import UserError
from omniocc.extras.recorders import Checks
from omniocc.parts import Parts
from omniocc.runs.script import quiet_libraries, script


@script("record")
def main(cfg: DictConfig) -> None:
    """Check the configuration and record, or check a CARLA server."""
    quiet_libraries()
    check(OmegaConf.masked_copy(cfg, ["recorder"]))
    recorder = Parts(cfg).recorder()
    if cfg.check:
        if not isinstance(recorder, Checks):
            raise UserError("check=true asks a CARLA server: it needs recorder=carla")
        report(recorder)
        return
    from omniocc.data.source.recorded import spec_of
    from omniocc.data.store.folder import SceneFolder

    scenes = recorder.record(Path(cfg.output))
    few = "" if covers_splits(Path(cfg.output)) else " 'data.source.splits={train:1,val:0,test:0}'"
    print(f"recorded  {scenes[0] if len(scenes) == 1 else f'{len(scenes)} scenes in {cfg.output}'}")
    print(f"look at it  python src/check.py data=recorded data.source.root={cfg.output}{few} --draw drawn")
    if not few:
        classes = spec_of(SceneFolder(scenes[0])).classes.num_classes
        data = f"data=recorded data.source.root={cfg.output} data.num_classes={classes}"
        print(f"train on it  python src/train.py {data}")


def covers_splits(folder: Path) -> bool:
    """Return whether a folder has scenes for training, validation and test by their names."""
    from omniocc.data.source import SPLITS

    names = [path.name for path in folder.iterdir() if "." not in path.name]
    return all(any(name.startswith(f"{split}-") for name in names) for split in SPLITS)


def report(recorder: Checks) -> None:
    """Print every assumption with pass or fail; exit with 1 if one fails."""
    findings = recorder.check()
    for finding in findings:
        print(f"{'pass' if finding.holds else 'FAIL'}  {finding.name} ({finding.measured})")
    failed = sum(not finding.holds for finding in findings)
    if failed:
        sys.exit(f"{failed} of {len(findings)} fail: recordings from this server would be wrong")


if __name__ == "__main__":
    main()
