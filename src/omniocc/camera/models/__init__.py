"""Camera models: from points to pixels and back, at any angle."""
