"""Building blocks of depth options."""
