"""Mathematics and fields of several camera models."""
