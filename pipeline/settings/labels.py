"""Section ``labels``: steering angles, the path ahead, and their source."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Positive, Section


class Labels(Section):
    source: Literal["oxts", "visual", "wheel"] = "oxts"
    wheelbase_m: Positive
    min_speed_mps: Annotated[float, Field(ge=0)]
    ahead_m: list[Annotated[float, Field(ge=0, le=200)]] = []  # no camera shows a road farther away
    max_stand_s: Annotated[float, Field(ge=0)] = 5.0

    @field_validator("ahead_m")
    @classmethod
    def _check_ascending(cls, edges: list[float]) -> list[float]:
        if sorted(set(edges)) != edges or len(edges) == 1:
            raise ValueError("expected ascending edges, two or more")
        return edges
