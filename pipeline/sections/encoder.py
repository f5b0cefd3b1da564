"""Section ``encoder``: how the unified encoder comes to its weights."""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pipeline.base.params import SPLITS, Count, Rate, Section, Seed
from pipeline.encoder import precomputed

PARTS = ("backbone", "depth_head", "class_head")


def _names_files(value: Any) -> Any:
    files = list(value.values()) if isinstance(value, dict) and set(value) <= set(PARTS) else [value]
    if value is None or (files and all(isinstance(file, str) for file in files)):
        return value
    raise ValueError(f"name a checkpoint, or a published file for each of some parts: {', '.join(PARTS)}")


Weights = Annotated[
    str | dict[str, str] | None,
    BeforeValidator(_names_files),
    Field(description="a checkpoint of this project, or the published file of each part; PATH or URL, #sha256=HEX"),
]


class Teacher(Section):
    """A fitted encoder whose classes teach frames that have no class truth."""

    key = "encoder.teacher"
    backbone: str
    weights: Weights
    drives: Annotated[
        Literal["train", "all"],
        Field(description="whose images it teaches on; an image needs no label, so all of ingest's are possible"),
    ] = "train"

    @model_validator(mode="after")
    def _is_fitted(self) -> Self:
        if self.backbone == precomputed.BACKBONE:
            raise ValueError("backbone: precomputed is not a network, so it cannot teach: name the backbone of one")
        if self.weights is None:
            raise ValueError("weights: null would teach random classes: name a fitted checkpoint or published files")
        return self


class Encoder(Section):
    key = "encoder"
    backbone: str
    weights: Weights
    frozen: Annotated[bool, Field(description="keep the backbone as it is and fit the heads alone")] = False
    teacher: Teacher | None = None
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Rate
    seed: Seed

    @property
    def splits(self) -> tuple[str, ...]:
        """Whose drives are opened."""
        return SPLITS if self.teacher and self.teacher.drives == "all" else ("train",)

    @model_validator(mode="after")
    def _comes_to_weights(self) -> Self:
        if self.backbone == precomputed.BACKBONE and not isinstance(self.weights, str):
            raise ValueError(f"backbone: precomputed reads {precomputed.LAYOUT}: name the folder in weights")
        if self.weights is None and self.epochs == 0:
            raise ValueError("epochs: 0 uses weights as they are: name a checkpoint in weights, or set epochs")
        if self.frozen and not (isinstance(self.weights, str) or (self.weights and "backbone" in self.weights)):
            raise ValueError("frozen: true keeps a backbone as weights has it, so name a checkpoint in weights")
        return self
