"""Errors of predictions, and the report on them. No other stage depends on this package, so an edit trains nothing."""
