"""Describe and compare artefacts, and check raw drives and the project: for the command line, not for stages."""
