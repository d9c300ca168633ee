"""Building blocks of lifters."""
