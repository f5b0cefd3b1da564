"""Images, videos, classes and the pinhole camera."""
