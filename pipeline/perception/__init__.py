"""Depth and classes of images: the unified encoder, its fit, the scale of depth, and errors against ground truth."""
