"""Mathematics that several camera models share."""
