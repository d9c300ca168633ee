"""Input of predictions: images, poses, sequences of frames and their schedule."""
