"""Frames on the time line of the Rerun viewer (extra `rerun`), https://rerun.io."""
