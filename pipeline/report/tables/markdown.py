"""Tables in Markdown."""

from collections.abc import Sequence


def table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table's lines."""
    return ["| " + " | ".join(cells) + " |" for cells in (header, ["---"] * len(header), *body)]
