"""Render the embedded sample: drives through a procedural world, in KITTI raw's layout."""
