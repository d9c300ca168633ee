"""The static part of a place: streets, land, plots and what stands on them."""
