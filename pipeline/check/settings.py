"""Declare all sections of ``params.yaml`` as one type."""

from typing import Annotated

from pydantic import Field, field_validator

from pipeline.base.params import Name, Section
from pipeline.clouds.settings import Clouds
from pipeline.encoder.settings import Encoder
from pipeline.evaluate.settings import BASELINES, Evaluate
from pipeline.graphs.settings import Variant
from pipeline.ingest.settings import Ingest
from pipeline.labels.settings import Labels
from pipeline.perception.settings import Perception
from pipeline.sample.settings import Sample
from pipeline.train.entry import Entry
from pipeline.train.settings import Train

# Names of lines in the report's pictures, whose colours are fixed.
LINES = ("driven", "measured", "predicted")


class Params(Section):
    """All of params.yaml."""

    sample: Sample
    ingest: Ingest
    labels: Labels
    encoder: Encoder
    perception: Perception
    clouds: Clouds
    graphs: Annotated[dict[Name, Variant], Field(min_length=1)]
    models: Annotated[dict[Name, Entry], Field(min_length=1)]
    train: Train
    evaluate: Evaluate

    @field_validator("models")
    @classmethod
    def _check_names(cls, models: dict[str, Entry]) -> dict[str, Entry]:
        taken = {*BASELINES, *LINES} & models.keys()
        if taken:
            problem = "is the name of a baseline, or of a line in pictures"
            raise ValueError(f"{min(taken)} {problem}: rename the model")
        return models
