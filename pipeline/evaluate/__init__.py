"""Evaluate predictions: errors, baselines, confidence intervals, paths."""
