"""Convert your own recording to a drive in KITTI raw's layout."""
