"""Loggers of a run: CSV and W&B."""

from omniocc.runs.wandb.loggers import Loggers

__all__ = ["Loggers"]
