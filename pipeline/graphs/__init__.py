"""Point clouds, kNN graphs and neighbourhoods, and the graph files that networks read."""
