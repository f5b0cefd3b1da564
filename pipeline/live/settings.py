"""What params.yaml says of the way from an image to a network's input, and whether a model was trained on that."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import Section, load, load_entry
from pipeline.sections.clouds import Clouds
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.motion import Motion
from pipeline.sections.perception import Perception


@dataclass(frozen=True)
class Settings:
    """The sections of a params file that the chain needs."""

    ingest: Ingest
    perception: Perception
    motion: Motion
    clouds: Clouds
    graphs: Variant


def read(params: Path, variant: str, data: Path) -> Settings:
    """Read the sections for a model whose input is graph variant `variant`.

    Raises InputError if the artefacts below `data` were made with other settings: then the network would see something
    that it was not trained on. Those that are not on this machine are not asked.
    """
    settings = Settings(
        load(Ingest, params),
        load(Perception, params),
        load(Motion, params),
        load(Clouds, params),
        load_entry(Variant, "graphs", variant, params),
    )
    source = settings.graphs.source
    made_with: list[tuple[str, str, Section, set[str]]] = [
        ("ingest", "ingest", settings.ingest, {"image_size"}),
        ("perception", "perception", settings.perception, {*Perception.model_fields} - {"batch"}),
        ("graphs", f"graphs/{variant}", settings.graphs, {*Variant.model_fields}),
    ]
    if source != "ingest":
        made_with.append(("clouds", source, settings.clouds, {*Clouds.model_fields}))
    for stage, folder, section, keys in made_with:
        stored = _stored(data / folder, stage)
        now = json.loads(section.model_dump_json())
        for key in sorted(keys & stored.keys()):
            if stored[key] != now[key]:
                raise InputError(
                    f"{params}: {stage}: {key} = {now[key]}, but {data / folder} was made with {stored[key]}, and the "
                    "model trained on that: run dvc repro, or name the params file that it was trained with by --params"
                )
    return settings


def _stored(folder: Path, stage: str) -> Mapping[str, Any]:
    """Return the section that made a stage's folder; empty where there is none."""
    for drive in store.indexed(folder):
        path = folder / f"{drive}.h5"
        if path.is_file():
            with store.DriveReader(path, stage=stage) as file:
                section: Mapping[str, Any] = file.params.get(stage, {})
                return section
    return {}
