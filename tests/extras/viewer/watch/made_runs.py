"""Folders of runs in progress, made by hand."""

import os
import time

CONFIG = "stages: {depth: {max_steps: 500}, sketch: {max_steps: null}, occupancy: {max_steps: 1000}}\n"


def make_run(folder, rows="step,train/loss,val/rayiou\n99,2.5,\n199,2.25,\n199,,0.375\n", age_s=0.0, began_s=100.0):
    """Write a run whose CSV file was begun `began_s` before its last change, `age_s` ago."""
    version = folder / "csv" / "version_0"
    version.mkdir(parents=True)
    (version / "metrics.csv").write_text(rows)
    (folder / "config.yaml").write_text(CONFIG)
    (folder / ".lock").touch()
    changed_s = time.time() - age_s
    os.utime(version / "metrics.csv", (changed_s, changed_s))
    os.utime(version, (changed_s - began_s, changed_s - began_s))
    return folder
