"""Section ``clouds``: semantic point clouds."""

from collections.abc import Callable
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_serializer

from pipeline.base.params import Count, Positive, Section, Seed
from pipeline.clouds.columns import SOURCES, check_column


def _check_names(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        check_column(name)
    if len({*names}) < len(names):
        raise ValueError("names a column twice")
    return names


# Names of further columns, of any source. Not strict, as a strict tuple takes no YAML list.
ColumnNames = Annotated[tuple[str, ...], Field(strict=False), AfterValidator(_check_names)]


class WithColumns(Section):
    """A section that chooses further columns of points."""

    columns: ColumnNames = ()

    @model_serializer(mode="wrap")
    def _leave_out_none(self, serialise: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Leave an empty list out, so that files and keys are as they were without this setting."""
        content = serialise(self)
        if not self.columns:
            content.pop("columns", None)
        return content


class Clouds(WithColumns):
    max_points: Count
    max_depth_m: Positive
    seed: Seed

    def of_source(self, source: str) -> Self:
        """Return the settings with those columns that a source of clouds has."""
        names = tuple(name for name in self.columns if name in SOURCES[source])
        return self.model_copy(update={"columns": names})
