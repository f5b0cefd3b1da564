"""Refuse a wheel: the commands need the checkout, with presets/, dvc.yaml and the included
models.
"""

import sys

from setuptools import setup

if "bdist_wheel" in sys.argv:
    sys.exit(
        "error: the commands need this checkout. Install it as it is: make setup, or pip install "
        "--editable ."
    )
setup()
