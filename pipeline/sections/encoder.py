"""Section ``encoder``: how the unified encoder comes to its weights."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from pipeline.params import Count, Positive, Section, Seed


class Encoder(Section):
    key = "encoder"
    backbone: str
    weights: str | None
    frozen: Annotated[bool, Field(description="keep the backbone as it is and fit the heads alone")] = False
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Positive
    seed: Seed

    @model_validator(mode="after")
    def _comes_to_weights(self) -> Self:
        if self.weights is None and self.epochs == 0:
            raise ValueError("epochs: 0 uses weights as they are: name a checkpoint in weights, or set epochs")
        if self.weights is None and self.frozen:
            raise ValueError("frozen: true keeps a backbone as weights has it, so name a checkpoint in weights")
        return self
