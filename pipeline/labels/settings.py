"""Section ``labels``: steering angles, the path ahead, and their source."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Section

# Distance between the axles of a car in metres.
Wheelbase = Annotated[float, Field(ge=0.5, le=20)]


class Labels(Section):
    # Folder in data/ with the speed and yaw rate: recorded ones, or those measured in images.
    source: Literal["ingest", "motion"] = "ingest"
    # Angles by the bicycle model from speed and yaw rate, or recorded ones.
    angle: Literal["computed", "recorded"] = "computed"
    wheelbase_m: Wheelbase
    min_speed_mps: Annotated[float, Field(ge=0)]
    # Edges in metres of the ranges into which the path ahead is split. No camera shows a road
    # farther away than 200 m.
    ahead_m: list[Annotated[float, Field(ge=0, le=200)]] = Field(default=[], max_length=50)
    # Longest time in seconds for which the car may stand on its path ahead.
    max_stand_s: Annotated[float, Field(ge=0)] = 5.0

    @property
    def are_measured(self) -> bool:
        """Whether labels follow from measured motion, which is then no input of their frame."""
        return self.source == "motion" and self.angle == "computed"

    @field_validator("ahead_m")
    @classmethod
    def _check_ascending(cls, edges: list[float]) -> list[float]:
        if sorted(set(edges)) != edges or len(edges) == 1:
            raise ValueError("expected ascending edges, two or more")
        return edges
