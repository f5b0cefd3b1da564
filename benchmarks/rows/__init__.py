"""The rows of ``make bench``, a file per subject. Each row is a function of what is measured, named in bench.py."""
