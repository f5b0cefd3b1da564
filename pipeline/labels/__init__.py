"""Steering labels: the bicycle model, sources of labels, and their comparison."""
