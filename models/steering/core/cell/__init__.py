"""Cells of `temporal: ncp`, one per file; temporal/ncp.py lists them."""
