"""Disturbances of recorded frames: worse images and calibrations, with the true labels kept."""
