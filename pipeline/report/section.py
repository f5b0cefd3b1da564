"""Tables of text, with a title and a note."""

from collections.abc import Mapping
from textwrap import fill
from typing import NamedTuple

import pandas as pd

from pipeline.report.number_text import NONE


class Section(NamedTuple):
    """A table of text with a title and a note. The index of the table is its first column."""

    title: str
    table: pd.DataFrame
    note: str = ""

    def markdown(self) -> str:
        """Return title, table and note in Markdown."""
        note = f"\n\n{fill(self.note, 110)}" if self.note else ""
        return f"## {self.title}\n\n{to_markdown(self.table)}{note}"


def to_markdown(table: pd.DataFrame) -> str:
    """Return a table in Markdown, with the index left- and the columns right-aligned."""
    table = table.reset_index()
    lines = [table.columns.tolist(), *table.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]

    # In the line below the headings, a colon aligns a column to the right.
    rule = ["-" * widths[0]]
    rule += ["-" * (width - 1) + ":" for width in widths[1:]]
    lines.insert(1, rule)
    rows = []
    for first, *others in lines:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        rows.append(f"| {' | '.join([first.ljust(widths[0]), *cells])} |")
    return "\n".join(rows)


def to_table(rows: Mapping[str, Mapping[str, str]], name: str) -> pd.DataFrame:
    """Return a table of rows. `name` is that of its index."""
    table = pd.DataFrame.from_dict(rows, orient="index").fillna(NONE).rename_axis(name)
    return without_dashes(table)


def without_dashes(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table without rows and columns that have no value."""
    has_value = table != NONE
    return table.loc[has_value.any(axis=1), has_value.any()]
