"""Rendering scenes into folders with several processes."""
