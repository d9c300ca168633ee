"""Sources of recorded scenes."""
