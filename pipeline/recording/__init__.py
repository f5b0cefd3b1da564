"""Convert a recording of one's own to a drive in KITTI raw's layout."""
