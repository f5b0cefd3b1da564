"""The contents of metrics.json and structure.json, which stage evaluate writes and the report reads.

data/README.md explains the keys.
"""

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_Number = Annotated[float, Field(ge=0, le=1e9)]
_Count = Annotated[int, Field(ge=0, le=10**12)]
_Point = Annotated[list[float], Field(min_length=3, max_length=3)]
_Pair = Annotated[list[_Count], Field(min_length=2, max_length=2)]


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Errors(_Form):
    """Errors of one predictor; None without frames, and nmse if every angle is 0."""

    frames: _Count
    mse_rad2: _Number | None
    rmse_deg: _Number | None
    mae_deg: _Number | None
    nmse: _Number | None


class ErrorsAndBaselines(Errors):
    baselines: dict[str, Errors]


class Bin(_Form):
    """Errors in a range of |curvature|; only the range and frames = 0 without frames."""

    from_1pm: _Number
    to_1pm: _Number | None
    frames: _Count
    mse_rad2: _Number | None = None
    rmse_deg: _Number | None = None
    mae_deg: _Number | None = None
    nmse: _Number | None = None
    zero: Errors | None = None


class Uncertainty(_Form):
    nll: float
    nll_constant: float
    coverage_68: _Number
    coverage_95: _Number
    mae_deg_certain: _Number


class Split(ErrorsAndBaselines):
    nmse_std: _Number | None
    nmse_ci95: Annotated[list[_Number], Field(min_length=2, max_length=2)]
    by_curvature: Annotated[list[Bin], Field(min_length=1)]
    by_drive: dict[str, ErrorsAndBaselines]
    without_decisions: ErrorsAndBaselines
    drift_m_per_100m: _Number | None
    uncertainty: Uncertainty | None = None


class Drives(_Form):
    train: list[str]
    val: list[str]
    test: list[str]


class Entry(_Form):
    """The settings of the model's entry that the report compares; other settings are kept as they are."""

    model_config = ConfigDict(extra="allow")
    input: str
    spatial: str
    temporal: str
    window: _Count
    horizon: _Count
    motion: str


class Variant(_Form):
    """The settings of the graph variant that the report shows; other settings are kept as they are."""

    model_config = ConfigDict(extra="allow")
    k: Annotated[int, Field(ge=1, le=1000)] | None = None
    keep_inter_class: Annotated[float, Field(ge=0, le=1)] | None = None


class Metrics(_Form):
    """Contents of metrics.json."""

    model: str
    line: Entry
    seeds: Annotated[list[int], Field(min_length=1)]
    drives: Drives
    parameters: _Count
    wheelbase_m: Annotated[float, Field(gt=0, le=100)]
    path: Literal["bicycle", "paper"]
    variant: Variant
    points_per_frame: _Number | None
    edges_per_frame: _Number | None
    edges_per_frame_unpruned: _Number | None
    train: Split | None
    val: Split | None
    test: Split


class Structure(_Form):
    """The graph of one frame; P points at most, of `points`."""

    frame: _Count
    points: _Count
    xyz_m: list[_Point]
    cls: list[Annotated[int, Field(ge=0, le=255)]]
    edges: list[_Pair]

    @model_validator(mode="after")
    def _rows_exist(self) -> Self:
        count = len(self.xyz_m)
        if len(self.cls) != count or any(max(pair) >= count for pair in self.edges):
            raise ValueError("cls or edges do not fit xyz_m")
        return self


class Structures(BaseModel):
    """Contents of structure.json: drive → graph."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Structure]
