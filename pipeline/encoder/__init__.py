"""Weights, fit and inference of the unified encoder."""
