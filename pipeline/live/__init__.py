"""Measure motion and predict steering on a stream of frames, and export trained models."""
