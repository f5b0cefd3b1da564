"""Where KITTI raw keeps things, and what they mean."""
