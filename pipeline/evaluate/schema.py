"""The contents of metrics.json and structure.json, which stage evaluate writes and the report reads.

data/README.md explains the keys.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, RootModel, model_validator

from pipeline.base.params import Fraction

Number = Annotated[float, Field(ge=0, le=1e9)]
Count = Annotated[int, Field(ge=0, le=10**12)]
# Without an upper limit: where nearly every angle is 0, the ratio to zero's error is huge.
Interval = Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=2, max_length=2)]
Point = Annotated[list[float], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Count], Field(min_length=2, max_length=2)]


class Form(BaseModel):
    """A JSON object: no other keys, types or numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Errors(Form):
    """Errors of one predictor; None without frames, nmse also if every angle is 0."""

    frames: Count
    mse_rad2: Number | None = None
    rmse_deg: Number | None = None
    mae_deg: Number | None = None
    nmse: Number | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (None in (self.mse_rad2, self.rmse_deg, self.mae_deg)) != (self.frames == 0):
            raise ValueError("expected all errors, or no frames")
        return self


class Bin(Errors):
    """Errors in a range of |curvature|, beside the errors of always predicting zero."""

    from_1pm: Number
    to_1pm: Number | None
    zero: Errors | None = None
    nmse_ci95: Interval | None = None


class ErrorsAndBaselines(Errors):
    baselines: dict[str, Errors]


class Uncertainty(Form):
    nll: float
    nll_constant: float
    coverage_68: Number
    coverage_95: Number
    mae_deg_certain: Number


class Split(ErrorsAndBaselines):
    nmse_std: Number | None
    nmse_ci95: Interval | None
    by_curvature: Annotated[list[Bin], Field(min_length=1)]
    by_drive: dict[str, ErrorsAndBaselines]
    without_decisions: ErrorsAndBaselines
    drift_m_per_100m: Number | None
    uncertainty: Uncertainty | None = None


class EntrySettings(Form, extra="allow"):
    """The model's entry: the settings that the report uses; further keys are allowed."""

    input: str
    spatial: str
    temporal: str
    window: Count
    horizon: Count
    motion: str
    predict: Literal["angle", "path"] = "angle"
    fit_to: str = "train"
    roads: Count | None = None
    cell: str | None = None
    equivariant: bool | None = None
    semantics: float | None = None


class VariantSettings(Form, extra="allow"):
    """The graph variant: the settings that the report uses; further keys are allowed."""

    k: Annotated[int, Field(ge=0, le=1000)] | None = None
    keep_inter_class: Fraction = 1.0
    accumulate: dict[str, Any] | None = None


class OdometryBaseline(Form):
    """The kind of motion of baseline odometry, and its regression coefficient."""

    kind: str
    coefficient: float | None


class Run(Form):
    """What metrics.json has for any model."""

    model: str
    line: EntrySettings
    seeds: Annotated[list[int], Field(min_length=1)]
    drives: dict[Literal["train", "val", "test"], list[str]]
    parameters: Count
    wheelbase_m: Annotated[float, Field(gt=0, le=100)]
    labels: str | None = None
    variant: VariantSettings
    points_per_frame: Number | None
    edges_per_frame: Number | None
    edges_per_frame_unpruned: Number | None


class Metrics(Run):
    """Contents of metrics.json of a model that predicts an angle."""

    path: Literal["bicycle", "paper"]
    odometry: OdometryBaseline | None = None
    train: Split | None
    val: Split | None
    test: Split


class RangeErrors(Form):
    """Errors in a range of the path ahead; None without frames, or if every path is straight."""

    frames: Count
    nmse: Number | None
    nmse_std: Number | None
    nmse_ci95: Interval | None
    coverage_68: Fraction | None = None
    baselines: dict[str, Number]


class Range(RangeErrors):
    from_m: Number
    to_m: Number
    without_decisions: RangeErrors


class PathMetrics(Run):
    """Contents of metrics.json of a model that predicts the path ahead."""

    train: list[Range] | None
    val: list[Range] | None
    test: list[Range]


class Structure(Form):
    """The graph of one frame: at most MAX_POINTS of its `points`."""

    frame: Count
    points: Count
    xyz_m: list[Point]
    cls: list[Annotated[int, Field(ge=0, le=255)]]
    edges: list[Pair]

    @model_validator(mode="after")
    def _rows_exist(self) -> Self:
        if len(self.cls) != len(self.xyz_m) or any(max(pair) >= len(self.xyz_m) for pair in self.edges):
            raise ValueError("cls or edges do not fit xyz_m")
        return self


class Structures(RootModel[dict[str, Structure]]):
    """Contents of structure.json: drive → graph."""
