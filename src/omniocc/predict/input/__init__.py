"""Images, poses and sequences to predict from."""
