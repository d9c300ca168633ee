"""Pages and facts on rendered scenes."""
