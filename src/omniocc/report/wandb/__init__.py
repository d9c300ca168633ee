"""The W&B dashboard, the upload of offline runs, and the viewer of all runs in the terminal."""
