"""Steering labels: the bicycle model, sources of labels, recorded angles, and their comparison."""
