"""One command per DVC stage: ``python -m stages.<name>``."""
