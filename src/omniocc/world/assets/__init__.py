"""Meshes of single things: surfaces, solids, buildings, trees, vehicles, people and street furniture."""
