"""Describe and draw files of the stages, for `steer show`."""
