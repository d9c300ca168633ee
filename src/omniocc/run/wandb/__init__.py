"""What a run logs to W&B."""
