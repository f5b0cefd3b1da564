"""Checkpoints, precision, learning rate and reading ahead, for the encoder's fit and for training."""
