"""Somebody's own recording becomes a drive in KITTI raw's layout."""
