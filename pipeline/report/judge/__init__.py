"""Judging predictions; nothing here is known to the trainer, so an edit re-trains nothing."""
