"""Where KITTI's cameras are mounted; the sample's, too."""

CAMERA_HEIGHT_M = 1.65  # above a flat ground
