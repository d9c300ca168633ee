"""Everything that moves in a place, as a function of time."""
