"""Recorders: what cameras on a real or simulated car have seen becomes scenes in this project's format."""
