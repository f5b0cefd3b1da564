"""Describe, draw and compare artefacts: `steer show` and `steer diff`."""
