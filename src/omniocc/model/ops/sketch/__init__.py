"""Building blocks of sketches."""
