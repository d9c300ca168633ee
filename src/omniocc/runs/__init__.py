"""What a run leaves behind: its folder, checkpoints, results, cost and logs."""
