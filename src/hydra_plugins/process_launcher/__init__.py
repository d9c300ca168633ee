"""Hydra launcher that runs every job of a multirun in its own process, several at a time."""

from hydra_plugins.process_launcher.launcher import ProcessLauncher

__all__ = ["ProcessLauncher"]
