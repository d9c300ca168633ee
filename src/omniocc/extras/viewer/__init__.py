"""Scenes, predictions and runs in progress for people to look at: in Rerun, in a page, in a browser."""
