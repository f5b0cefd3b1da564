"""Section ``labels``: steering angles and their source."""

from typing import Annotated, Literal

from pydantic import Field

from pipeline.base.params import MotionKind, Positive, Section


class Labels(Section):
    key = "labels"
    source: Literal["oxts", MotionKind, "wheel"] = "oxts"
    wheelbase_m: Positive
    min_speed_mps: Annotated[float, Field(ge=0)]
    standstill: Literal["invalid", "raw", "zero"]
