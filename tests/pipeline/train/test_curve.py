"""Selected epoch, patience and curve.csv."""

from typing import get_args

import pytest

from pipeline.sections.train import Train
from pipeline.train.curve import Epoch, out_of_patience, selected_epoch


def epochs(*val_nmse):
    return [Epoch(number, 0.1, 0.1, 0.1, nmse) for number, nmse in enumerate(val_nmse, start=1)]


def test_each_rule_selects_its_epoch():
    lucky_second = epochs(0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7)
    assert selected_epoch(lucky_second, "best") == 2
    assert selected_epoch(lucky_second, "smoothed") == 6
    assert selected_epoch(lucky_second, "last") == 7


def test_patience_counts_epochs_since_the_selected_one():
    rows = epochs(0.9, 0.5, 0.6, 0.7)
    assert out_of_patience(rows, "best", patience=2)
    assert not out_of_patience(rows, "best", patience=3)
    assert not out_of_patience(rows, "last", patience=1)


@pytest.mark.parametrize("keep", get_args(Train.model_fields["keep"].annotation))
def test_epochs_without_validation_error_are_not_selected(keep):
    nothing = float("nan")
    assert selected_epoch(epochs(0.9, 0.8, nothing), keep) == (3 if keep == "last" else 2)
    assert selected_epoch(epochs(nothing, nothing), keep) == 2
    assert selected_epoch([], keep) == 0
