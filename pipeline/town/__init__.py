"""The embedded sample: a procedural street world, driven through and written in KITTI raw's layout."""
