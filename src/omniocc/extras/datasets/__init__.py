"""Readers of further public datasets."""
