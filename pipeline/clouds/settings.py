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


_KNOWN = sorted({name for columns in SOURCES.values() for name in columns})
# Name of a further column, of any source.
_ColumnName = Annotated[str, Field(json_schema_extra={"enum": [*_KNOWN]})]
# Not strict, as a strict tuple takes no YAML list.
ColumnNames = Annotated[tuple[_ColumnName, ...], Field(strict=False), AfterValidator(_check_names)]


class WithColumns(Section):
    """A section that chooses further columns of points."""

    columns: ColumnNames = Field(
        default=(),
        description="further columns of each point. A variant has those of `clouds` that it names",
    )

    @model_serializer(mode="wrap")
    def _leave_out_none(self, serialise: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Leave an empty list out, so that files and keys are as they were without this setting."""
        content = serialise(self)
        if not self.columns:
            content.pop("columns", None)
        return content


class Clouds(WithColumns):
    max_points: Count = Field(
        description="largest number of points of a frame, drawn at random. The paper's clouds have "
        "43,000 and more"
    )
    max_depth_m: Positive = Field(
        description="depth in metres beyond which a pixel gives no point, since monocular depth is "
        "useless there"
    )
    seed: Seed = Field(description="seed of the draws")

    def of_source(self, source: str) -> Self:
        """Return the settings with those columns that a source of clouds has."""
        names = tuple(name for name in self.columns if name in SOURCES[source])
        return self.model_copy(update={"columns": names})
