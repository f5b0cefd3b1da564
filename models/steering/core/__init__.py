"""Code shared by the steering networks."""
