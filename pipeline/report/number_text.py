"""Write numbers, errors and differences as text."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.evaluate import statistics
from pipeline.train.quantity import Measure

# Text of a cell without a value.
NONE = "–"


def value_text(value: Any, form: str = "") -> str:
    """Return a value as text with a typographic minus, or NONE if it is missing."""
    return NONE if pd.isna(value) else format(value, form).replace("-", "−")


def error_text(row: pd.Series, measure: Measure) -> str:
    """Return the error of a row, or NONE if it has none."""
    value = statistics.value_of(row)
    return NONE if value is None else statistics.number_text(value, measure)


def difference_text(row: Mapping[str, Any] | pd.Series, form: str) -> str:
    """Return the difference of a row as text with a typographic minus."""
    value = statistics.value_of(row)
    return NONE if value is None else statistics.signed_text(value, form).replace("-", "−")


def bounds_text(row: Mapping[str, Any] | pd.Series, form: str) -> str:
    """Return the interval of a row of differences as text with a typographic minus."""
    return statistics.bounds_text(row, form).replace("-", "−")


def with_unit(text: str, measure: Measure) -> str:
    """Return a number as text with the unit of its measure."""
    return f"{text} {measure.unit}".strip()
