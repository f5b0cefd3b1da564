"""Sections of ``params.yaml``, one typed class per file, so that an edit of one section runs only its stage."""
