"""Mathematics and fields that several camera models share."""
