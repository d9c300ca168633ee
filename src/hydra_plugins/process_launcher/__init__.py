"""Hydra launcher: every job of a multirun is a process of its own, some at a time."""

from hydra_plugins.process_launcher.launcher import ProcessLauncher

__all__ = ["ProcessLauncher"]
