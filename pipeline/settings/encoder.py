"""Section ``encoder``: the unified encoder, the files of its weights, and how it is fitted."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from pipeline.base.params import SPLITS, Count, Rate, Section, Seed, matches

PARTS = ("backbone", "depth_head", "class_head")
PRECOMPUTED = "precomputed"
"""The backbone that stands for a folder of PNG files, see pipeline/perception/precomputed.py."""
WEIGHTS = Path("weights")  # downloaded files


class WeightFile(BaseModel):
    """A file of weights: ``{url, sha256, key}``, or its path or URL alone."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    url: Annotated[str, Field(min_length=1)]
    sha256: Annotated[str, matches("[0-9a-f]{64}", "64 digits 0-9 and a-f, as sha256sum prints them")] | None = None
    key: Annotated[str, matches(r"\w[\w.-]*(/\w[\w.-]*)*", "a relative path of letters, digits, _, . and -")] | None = (
        None
    )

    @property
    def is_url(self) -> bool:
        return self.url.startswith(("https://", "http://", "file://"))

    @property
    def path(self) -> Path:
        """Where the file is, or will be after the download: weights/KEY, by default the last part of the URL."""
        return WEIGHTS / (self.key or self.url.rsplit("/", 1)[-1]) if self.is_url else Path(self.url)

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, value: Any) -> Any:
        return {"url": value} if isinstance(value, str) else value


class Weights(Section):
    """Setting ``weights``: one checkpoint of this project, or published files of single parts."""

    checkpoint: WeightFile | None = None
    backbone: WeightFile | None = None
    depth_head: WeightFile | None = None
    class_head: WeightFile | None = None

    @property
    def parts(self) -> dict[str, WeightFile]:
        return {part: file for part in PARTS if (file := getattr(self, part))}

    def has(self, part: str) -> bool:
        return self.checkpoint is not None or part in self.parts

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any) -> Any:
        is_file = isinstance(value, dict) and not value.keys().isdisjoint(WeightFile.model_fields)
        return {"checkpoint": value} if is_file or isinstance(value, str) else value

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if bool(self.checkpoint) == bool(self.parts):
            raise ValueError("expected a checkpoint, or the published file of one or more parts")
        return self


class Teacher(Section):
    """A fitted encoder whose classes are the training targets of frames without class labels."""

    backbone: str
    weights: Weights
    drives: Literal["train", "all"] = "train"


class Encoder(Section):
    key = "encoder"
    backbone: str
    weights: Weights | None = None
    frozen: bool = False
    teacher: Teacher | None = None
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Rate
    seed: Seed

    @property
    def splits(self) -> tuple[str, ...]:
        return SPLITS if self.teacher and self.teacher.drives == "all" else ("train",)

    @property
    def folder(self) -> Path | None:
        """Return the folder of a precomputed encoder; None for a network."""
        file = self.weights.checkpoint if self.weights and self.backbone == PRECOMPUTED else None
        return file.path if file else None

    @model_validator(mode="after")
    def _has_weights(self) -> Self:
        if self.backbone == PRECOMPUTED and not (self.weights and self.weights.checkpoint):
            raise ValueError(f"backbone: {PRECOMPUTED} needs a folder of PNG files in weights, see docs/models.md")
        if self.weights is None and self.epochs == 0:
            raise ValueError("epochs: 0 needs fitted weights: name a checkpoint in weights, or set epochs")
        if self.frozen and not (self.weights and self.weights.has("backbone")):
            raise ValueError("frozen: true needs the backbone's weights: name a file in weights")
        return self
