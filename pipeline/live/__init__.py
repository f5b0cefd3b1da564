"""A trained model on what a camera sees, frame by frame."""
