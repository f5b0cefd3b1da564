"""All sections of ``params.yaml`` as one type, for stage check and for presets."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from pipeline.base.errors import error_context
from pipeline.base.params import NAME, Section, parse
from pipeline.sections.clouds import Clouds
from pipeline.sections.encoder import Encoder
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.labels import Labels
from pipeline.sections.models import Model
from pipeline.sections.motion import Motion
from pipeline.sections.perception import Perception
from pipeline.sections.pictures import Pictures
from pipeline.sections.town import Town
from pipeline.sections.train import Train


def _check_name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError("expected at most 100 letters A-Z and a-z, digits, _ and -, no _ or - first")
    return name


Name = Annotated[str, AfterValidator(_check_name)]


class Params(Section):
    """All of params.yaml."""

    town: Town
    ingest: Ingest
    labels: Labels
    encoder: Encoder
    perception: Perception
    motion: Motion
    clouds: Clouds
    pictures: Pictures
    graphs: Annotated[dict[Name, Variant], Field(min_length=1)]
    models: Annotated[dict[Name, Model], Field(min_length=1)]
    train: Train
    evaluate: Evaluate


ENTRIES: dict[str, type[Section]] = {"graphs": Variant, "models": Model}


def validate(content: dict[str, Any], where: Path) -> Params:
    """Return the content of a complete params file as :class:`Params`. Raises InputError, which names `where`."""
    parsed = dict(content)
    with error_context(where):
        # Section by section, so that messages suggest the section's own keys.
        for key, value in content.items():
            if key in ENTRIES and isinstance(value, dict):
                parsed[key] = {name: parse(ENTRIES[key], entry, f"{key}.{name}") for name, entry in value.items()}
            elif key in Params.model_fields and key not in ENTRIES:
                kind: Any = Params.model_fields[key].annotation
                parsed[key] = parse(kind, value, key)
        return parse(Params, parsed, "")
