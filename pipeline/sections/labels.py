"""Section ``labels``: steering angles from oxts."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import Positive, Section


class Labels(Section):
    key = "labels"
    wheelbase_m: Positive
    min_speed_mps: Annotated[float, Field(ge=0)]
    standstill: Literal["invalid", "raw", "zero"]
