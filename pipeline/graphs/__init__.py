"""Clouds, kNN graphs and neighbourhoods, and the files that networks read."""
