"""Section ``labels``: steering angles, the path ahead, and their source."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pipeline.base.params import Section

# Distance between the axles of a car in metres.
Wheelbase = Annotated[float, Field(ge=0.5, le=20)]


class Labels(Section):
    source: Literal["ingest", "motion"] = Field(
        default="ingest",
        description="stage with the speed and yaw rate: `ingest` recorded them (oxts, or a log), "
        "`motion` measures them in images",
    )
    angle: Literal["computed", "recorded"] = Field(
        default="computed",
        description="steering angles: `computed` by the bicycle model from speed and yaw rate, or "
        "`recorded` (steering.csv, or a log of the wheel)",
    )
    wheelbase_m: Wheelbase = Field(
        description="distance between the axles of the car in metres, paper section 4.1"
    )
    min_speed_mps: float = Field(
        ge=0,
        description="speed in m/s below which a frame has no label, because the bicycle model "
        "divides noise by noise. With 0 all frames have one, as in the paper",
    )
    # No camera shows a road farther away than 200 m.
    ahead_m: list[Annotated[float, Field(ge=0, le=200)]] = Field(
        default=[],
        max_length=50,
        description="ascending edges in metres of the ranges into which `predict: path` splits the "
        "path ahead. With [] no path is labelled",
    )
    max_stand_s: float = Field(
        default=5.0,
        ge=0,
        description="longest time in seconds for which the car may stand on its path ahead. A path "
        "with a longer stop has no label",
    )

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
