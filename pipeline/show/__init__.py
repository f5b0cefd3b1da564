"""Describe, draw and compare artefacts, check raw drives and the project: for `steer show`, `diff` and `doctor`."""
