"""Measure motion and predict steering on a stream of frames."""
