"""Files beside the curves of a run: artifacts of W&B."""

import os
import re
from pathlib import Path

ODD = re.compile(r"[^\w.-]+")


def log_file(folder: Path, file: Path, project: str) -> None:
    """Keep a file for W&B as an artifact of type `view`, in an offline run of its own in a run's folder.

    `make wandb-sync` uploads it with the others; a file that is logged again becomes the artifact's next version.
    """
    os.environ.setdefault("WANDB_SILENT", "true")
    import wandb

    with wandb.init(dir=folder, name=f"{folder.name} view", project=project, job_type="view", mode="offline") as run:
        artifact = wandb.Artifact(ODD.sub("-", f"{folder.name}-{file.name}"), type="view")
        artifact.add_file(str(file))
        run.log_artifact(artifact)
    wandb.teardown()  # `finish` alone may return before the file is whole
