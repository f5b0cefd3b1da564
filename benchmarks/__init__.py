"""Measure this project beside its alternatives: ``python -m benchmarks.bench`` (``make bench``)."""
