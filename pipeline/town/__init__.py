"""Render the embedded sample: drives through a procedural town, in KITTI raw's layout."""
