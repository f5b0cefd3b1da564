"""The sections of ``params.yaml``, one typed class each. A stage loads only its own.

Units stand in names or descriptions; a value out of range, an unknown key or a wrong type is an
:class:`~pipeline.errors.InputError` that names file, key, value and what is allowed.
"""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from pipeline.errors import InputError, closest

Drive = Annotated[str, Field(pattern=r"^\d{4}_\d{2}_\d{2}_drive_\d{4}$", description="as 2011_09_26_drive_0052")]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Fraction = Annotated[float, Field(ge=0, le=1)]
ImageSize = Annotated[tuple[int, int], Field(description="[H, W] in pixels")]
SPLITS = ("train", "val", "test")


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    key: ClassVar[str]


class Drives(Section):
    """Which drives each split holds. `val` may be empty: then there is no early stopping."""

    train: list[Drive] = Field(min_length=1)
    val: list[Drive] = []
    test: list[Drive] = Field(min_length=1)

    @model_validator(mode="after")
    def _disjoint(self) -> Self:
        names = self.train + self.val + self.test
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is named twice: a drive belongs to one split, once")
        return self

    def splits(self) -> dict[str, str]:
        """Return drive → split, in the order train, val, test."""
        return {drive: split for split in SPLITS for drive in getattr(self, split)}


class Ingest(Section):
    key = "ingest"
    source: Literal["town", "kitti"]
    image_size: ImageSize
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(min_length=1)
    lidar: bool
    on_damaged: Literal["fail", "skip"]
    drives: Drives

    @field_validator("image_size")
    @classmethod
    def _size(cls, size: tuple[int, int]) -> tuple[int, int]:
        if not all(32 <= side <= 4096 for side in size):
            raise ValueError("each side must be 32 to 4096 pixels")
        return size


class Frames(Section):
    """Frames per drive of each split."""

    train: Count
    val: Count
    test: Count


class Town(Section):
    key = "town"
    seed: int
    image_size: ImageSize
    frames: Frames
    scan_rays: Annotated[tuple[int, int], Field(description="[rings, rays per ring] of the LiDAR")]


class Labels(Section):
    key = "labels"
    wheelbase_m: Positive
    min_speed_mps: Annotated[float, Field(ge=0)]
    standstill: Literal["invalid", "raw", "zero"]


class Encoder(Section):
    key = "encoder"
    backbone: str
    weights: str | None
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Positive
    seed: int


class Perception(Section):
    key = "perception"
    batch: Count


class Clouds(Section):
    key = "clouds"
    max_points: Count
    max_depth_m: Positive
    seed: int


class Variant(Section):
    """One entry of ``graphs``: what a network eats."""

    cloud: Literal["pseudo", "lidar"]
    points: Count
    k: Annotated[int, Field(ge=1, le=32)]
    keep_inter_class: Fraction = 1.0
    seed: int = 0


class Wiring(Section):
    """Neural circuit policy: neuron counts and fan-outs (Lechner et al. 2020)."""

    inter: Count = 12
    command: Count = 6
    sensory_fanout: Count = 6
    inter_fanout: Count = 4
    recurrent_command_synapses: Annotated[int, Field(ge=0)] = 6
    motor_fanin: Count = 6
    seed: int = 0


class Model(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant."""

    input: str
    spatial: str
    temporal: str
    window: Annotated[int, Field(ge=1, le=256, description="frames that a prediction sees")]
    semantics: Fraction = 0.0
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    layers: list[Count] = Field(default=[32, 32, 64], min_length=1, description="widths of the spatial network")
    features: Count = 32
    units: Count = 32
    wiring: Wiring = Wiring()


class Train(Section):
    key = "train"
    epochs: Count
    patience: Count
    seeds: list[int] = Field(min_length=1)
    learning_rate: Positive
    weight_decay: Annotated[float, Field(ge=0)]
    clip_norm: Positive
    run_windows: Count
    batch_runs: Count
    mirror: bool

    @field_validator("seeds")
    @classmethod
    def _distinct(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice: each adds a training run, so name it once")
        return seeds


class Evaluate(Section):
    key = "evaluate"
    bootstrap_samples: Count
    bootstrap_block_frames: Count
    curvature_bins_1pm: list[Positive] = Field(min_length=1, description="edges between the bins of |curvature|")
    seed: int


S = TypeVar("S", bound=Section)

SECTIONS: dict[str, type[Section]] = {
    section.key: section for section in (Town, Ingest, Labels, Encoder, Perception, Clouds, Train, Evaluate)
}
MAPPINGS: dict[str, type[Section]] = {"graphs": Variant, "models": Model}


def load(section: type[S], path: Path) -> S:
    """Read one section of the params file at `path`. Raises InputError as the module says."""
    content = _read(path)
    if section.key not in content:
        raise InputError(f"{path} has no section {section.key!r}: take it from the project's own params.yaml")
    return _parse(section, content[section.key], path, section.key)


def load_entry(kind: type[S], mapping: str, name: str, path: Path) -> S:
    """Read one entry of a mapping section, for instance variant `name` of ``graphs``. Raises InputError."""
    content = _read(path)
    entries = content.get(mapping)
    if not isinstance(entries, dict) or name not in entries:
        known = list(entries) if isinstance(entries, dict) else []
        raise InputError(f"{path}: {mapping} has no {name!r}: {closest(name, known)}")
    return _parse(kind, entries[name], path, f"{mapping}.{name}")


def names(mapping: str, path: Path) -> list[str]:
    """Return the names in a mapping section (``graphs`` or ``models``), in the file's order."""
    entries = _read(path).get(mapping)
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: section {mapping!r} is missing or empty: it needs at least one entry")
    return list(entries)


def check(path: Path) -> None:
    """Read every section and entry. Raises InputError for the first fault, and if a model's input is no variant."""
    for section in SECTIONS.values():
        load(section, path)
    variants = names("graphs", path)
    for name in variants:
        load_entry(Variant, "graphs", name, path)
    for name in names("models", path):
        model = load_entry(Model, "models", name, path)
        if model.input not in variants:
            near = closest(model.input, variants)
            raise InputError(f"{path}: models.{name}.input = {model.input!r} is no variant of graphs: {near}")


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path} is missing: run from the repository's root, or: git checkout {path.name}")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise InputError(f"{path} is no YAML: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} holds no sections")
    known = [*SECTIONS, *MAPPINGS]
    for name in content:
        if name not in known:
            raise InputError(f"{path}: unknown section {name!r}: {closest(str(name), known)}")
    return content


def _parse(kind: type[S], value: Any, path: Path, where: str) -> S:
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *(str(part) for part in first["loc"])])
        if first["type"] == "extra_forbidden":
            known = list(kind.model_fields)
            raise InputError(f"{path}: unknown key {key}: {closest(str(first['loc'][-1]), known)}") from error
        if first["type"] == "missing":
            raise InputError(f"{path}: {key} is missing: take it from the project's own params.yaml") from error
        raise InputError(f"{path}: {key} = {first['input']!r}: {first['msg'].removeprefix('Value error, ')}") from error
