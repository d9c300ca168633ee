"""What a run logs to W&B."""

from omniocc.run.wandb.loggers import Loggers

__all__ = ["Loggers"]
