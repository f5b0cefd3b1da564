"""Depth and classes of images: depth scale, frames of a drive, errors against ground truth; errors of motion."""
