"""The W&B dashboard and the upload of offline runs."""
