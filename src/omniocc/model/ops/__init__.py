"""Building blocks of the slots."""
