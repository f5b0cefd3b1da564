"""Run the examples in docstrings."""

import doctest
import importlib

import pytest

from pipeline.base.checkout import ROOT

PACKAGES = ("footage", "models", "pipeline", "steer")
FILES = [
    path.relative_to(ROOT)
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text()
]


@pytest.mark.parametrize("path", FILES, ids=str)
def test_examples_print_what_they_say(path):
    module = importlib.import_module(".".join(path.with_suffix("").parts))
    results = doctest.testmod(module)
    assert results.attempted
    assert not results.failed
