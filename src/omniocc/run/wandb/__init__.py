"""Loggers of a run: CSV and W&B."""

from omniocc.run.wandb.loggers import Loggers

__all__ = ["Loggers"]
