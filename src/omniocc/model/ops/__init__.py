"""Building blocks that several slots share."""
