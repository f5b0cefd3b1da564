"""Steering networks: a spatial network per frame, a recurrent one over the frames of a window."""
