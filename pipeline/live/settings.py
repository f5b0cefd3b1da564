"""The sections of params.yaml that lead from an image to the network's input, compared with existing artefacts."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import load, load_entry
from pipeline.camera.camera import read_camera
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.settings.clouds import Clouds
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import Ingest
from pipeline.settings.perception import Perception


@dataclass(frozen=True)
class Settings:
    """The sections that the chain needs."""

    ingest: Ingest
    perception: Perception
    clouds: Clouds
    variant: Variant


def load_settings(params: Path, variant: str, data: Path) -> Settings:
    """Load the sections for a model with graph variant `variant` as input.

    Raises InputError if artefacts below `data` were made with other settings: the network was trained on those.
    Artefacts that this machine lacks are not compared.
    """
    sections = load(Ingest, params), load(Perception, params), load(Clouds, params)
    settings = Settings(*sections, load_entry(Variant, "graphs", variant, params))
    current = {
        "ingest": settings.ingest.model_dump(mode="json", include={"image_size"}),
        "perception": settings.perception.model_dump(mode="json", exclude={"batch"}),
        f"graphs/{variant}": settings.variant.model_dump(mode="json"),
    }
    if settings.variant.source != "ingest":
        current[settings.variant.source] = settings.clouds.model_dump(mode="json")
    for folder, values in current.items():
        _compare(values, data / folder, folder.split("/")[0], params)
    return settings


def focal_by_width(data: Path) -> float | None:
    """Return focal length / image width of the first drive in `data`/ingest; None without files or calibration."""
    with _first_file(data / "ingest", "ingest") as file:
        camera = read_camera(file, CAMERA_HEIGHT_M) if file else None
        return float(camera.K[0, 0] / camera.size[1]) if camera and camera.K[0, 0] > 1 else None


def _compare(current: dict[str, Any], folder: Path, stage: str, params: Path) -> None:
    """Raise InputError if the first file of a stage's folder was made with other settings than the `current` ones."""
    with _first_file(folder, stage) as file:
        stored = file.params.get(stage, {}) if file else {}
    for key in sorted(current.keys() & stored.keys()):
        if stored[key] != current[key]:
            problem = f"{key} = {current[key]}, but {folder}, on which the model depends, was made with {stored[key]}"
            fix = "Run dvc repro, or pass the params file of the model: --params"
            raise InputError(problem, f"{params}: {stage}", fix)


def _first_file(folder: Path, stage: str) -> AbstractContextManager[store.DriveReader | None]:
    """Return the first file of a stage's folder, open; None without files."""
    paths = (folder / f"{drive}.h5" for drive in store.indexed(folder))
    path = next((path for path in paths if path.is_file()), None)
    return store.DriveReader(path, stage=stage) if path else nullcontext()
