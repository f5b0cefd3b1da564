"""The steering networks: a spatial one on each frame, a recurrent one over frames."""
