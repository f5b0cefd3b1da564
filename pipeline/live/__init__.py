"""Prediction on a stream of frames, and export of trained models."""
