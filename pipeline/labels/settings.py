"""Section ``labels``: steering angles, the path ahead, and their source."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator

from pipeline.base.errors import closest
from pipeline.base.params import Section

# Names of the sources. Each is the name of a file in the folder sources.
SOURCES = sorted(path.stem for path in (Path(__file__).parent / "sources").glob("[!_]*.py"))

# Distance between the axles of a car in metres.
Wheelbase = Annotated[float, Field(ge=0.5, le=20)]


class Labels(Section):
    # Name of a file in pipeline/labels/sources.
    source: str = "recorded"
    wheelbase_m: Wheelbase
    min_speed_mps: Annotated[float, Field(ge=0)]
    # Edges in metres of the ranges into which the path ahead is split. No camera shows a road
    # farther away than 200 m.
    ahead_m: list[Annotated[float, Field(ge=0, le=200)]] = Field(default=[], max_length=50)
    # Longest time in seconds for which the car may stand on its path ahead.
    max_stand_s: Annotated[float, Field(ge=0)] = 5.0

    @field_validator("source")
    @classmethod
    def _check_source(cls, source: str) -> str:
        if source not in SOURCES:
            path = f"pipeline/labels/sources/{source}.py"
            raise ValueError(f"there is no {path} ({closest(source, SOURCES)})")
        return source

    @field_validator("ahead_m")
    @classmethod
    def _check_ascending(cls, edges: list[float]) -> list[float]:
        if sorted(set(edges)) != edges or len(edges) == 1:
            raise ValueError("expected ascending edges, two or more")
        return edges
