"""Find faults in the whole params file before any stage spends time: it has no outputs."""

from collections.abc import Iterable
from pathlib import Path

from pipeline.base import console, imports
from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.params import load, load_entry, names
from pipeline.encoder import precomputed, weights
from pipeline.sections.clouds import Clouds
from pipeline.sections.encoder import Encoder, Teacher
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.labels import Labels
from pipeline.sections.models import Model, resolve
from pipeline.sections.motion import Motion
from pipeline.sections.perception import Perception
from pipeline.sections.pictures import Pictures
from pipeline.sections.town import Town
from pipeline.sections.train import Train
from pipeline.train import runs

# What DVC watches for every model; beside it, of networks, only the two files that a model's line names.
WATCHED = {Path("models/steering/core"), Path("pipeline/camera/classes.py")}


def main(params: Path = Path("params.yaml")) -> Path:
    """Read every section; build every network once, so that one that cannot be is noticed now, and look for weights.

    Nothing is fetched, and no file of weights is opened. Returns `params`.
    """
    for section in (Town, Ingest, Labels, Perception, Motion, Clouds, Pictures, Train, Evaluate):
        load(section, params)
    with error_context(str(params)):
        check_encoder(load(Encoder, params))
    ingest, motion = load(Ingest, params), load(Motion, params)
    if "lidar" in motion.kinds and not ingest.lidar:
        raise InputError(f"{params}: motion.kinds: lidar is measured from scans, and ingest.lidar: false reads none")
    variants = {name: load_entry(Variant, "graphs", name, params) for name in names("graphs", params)}
    for name, variant in variants.items():
        if variant.accumulate and variant.accumulate.motion not in motion.kinds:
            raise InputError(f"{params}: graphs.{name}.accumulate.{not_measured(variant.accumulate.motion, motion)}")
    for name in names("models", params):
        settings = load_entry(Model, "models", name, params)
        try:
            check_model(settings, variants, ingest, motion)
        except (InputError, ValueError) as error:
            raise InputError(f"{params}: models.{name}.{error}") from error
    return params


def check_encoder(encoder: Encoder) -> None:
    """Build the encoder and its teacher, and look where their weights lie. Raises InputError."""
    import torch

    from models.encoder import unified_encoder

    networks: list[Encoder | Teacher] = [encoder, encoder.teacher] if encoder.teacher else [encoder]
    for network in networks:
        if network.backbone == precomputed.BACKBONE:
            precomputed.find(Path(str(network.weights)))
            continue
        with error_context(f"{network.key}.backbone = {network.backbone!r}"):
            if network.backbone not in unified_encoder.BACKBONES:
                known = [*unified_encoder.BACKBONES, precomputed.BACKBONE]
                raise InputError(f"no such backbone: {closest(network.backbone, known)}")
            with torch.device("meta"):  # takes neither memory nor time
                unified_encoder.UnifiedEncoder(network.backbone)
        for key, file in weights.files(network.weights, f"{network.key}.weights").items():
            weights.locate(file, key)


def check_model(settings: Model, variants: dict[str, Variant], ingest: Ingest, motion: Motion) -> None:
    """Build a model's network. Raises InputError or ValueError, whose text starts with the key that is wrong."""
    from models.steering.core import steering_net

    if settings.input not in variants:
        raise ValueError(
            f"input = {settings.input!r} is not a variant in graphs: {closest(settings.input, [*variants])}"
        )
    if settings.motion not in ("none", *motion.kinds):
        raise ValueError(not_measured(settings.motion, motion))
    if variants[settings.input].source == "clouds/lidar" and not ingest.lidar:
        raise ValueError(f"input = {settings.input!r} is made of scans, and ingest.lidar: false reads none")
    variant, line = variants[settings.input], resolve(settings)
    runs.folds(ingest.drives.splits(), line)
    steering_net.build(line, variant.kind, len(variant.levels), ingest.image_size)
    for part in ("spatial", "temporal"):
        name = line[part]
        module, own = f"models.steering.{part}.{name}", Path(f"models/steering/{part}/{name}.py")
        if others := unwatched(imports.import_closure(module), own):
            raise ValueError(
                f"{part} = {name!r}: {own} uses {', '.join(map(str, others))}, which could be edited without training "
                "this model again: move what it needs from there to models/steering/core"
            )


def not_measured(kind: str, motion: Motion) -> str:
    return f"motion = {kind!r} is not measured: motion.kinds has {', '.join(motion.kinds)}"


def unwatched(files: Iterable[Path], own: Path) -> list[Path]:
    """Return those of a network's imported files whose edits DVC would not notice; packages' docstrings aside."""
    return [
        file
        for file in files
        if file != own and file not in WATCHED and WATCHED.isdisjoint(file.parents) and file.name != "__init__.py"
    ]


if __name__ == "__main__":
    console.run(main)
