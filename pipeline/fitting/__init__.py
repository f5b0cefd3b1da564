"""What both fits share: the encoder's and the steering networks'."""
