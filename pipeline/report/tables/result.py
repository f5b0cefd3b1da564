"""What a model's metrics.json must hold to be shown: the file of stage evaluate, as far as tables and pages read it."""

from pydantic import BaseModel

Number = float | None


class Errors(BaseModel):
    """Figures of some frames."""

    frames: int
    mse_rad2: Number
    rmse_deg: Number
    mae_deg: Number
    nmse: Number


class Scores(Errors):
    """Figures of a split."""

    nmse_std: Number
    nmse_ci95: tuple[Number, Number]
    baselines: dict[str, Errors | None]
    by_drive: dict[str, Errors]
    by_curvature: list[dict[str, object]] | dict[str, object]
    without_decisions: Errors | None = None


class Line(BaseModel):
    """The model's line."""

    input: str
    spatial: str
    temporal: str
    window: int


class Result(BaseModel):
    """metrics.json."""

    model: str
    line: Line
    seeds: list[int]
    drives: dict[str, list[str]]
    variant: dict[str, object]
    parameters: int
    points_per_frame: Number  # images have none
    train: Scores
    val: Scores | None
    test: Scores
