"""Find faults in the whole params file before any stage spends time: it has no outputs."""

from pathlib import Path

from pipeline.base import console
from pipeline.base.errors import InputError, closest
from pipeline.base.params import load, load_entry, names
from pipeline.encoder import precomputed, weights
from pipeline.sections.clouds import Clouds
from pipeline.sections.encoder import Encoder, Teacher
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.labels import Labels
from pipeline.sections.models import Model
from pipeline.sections.perception import Perception
from pipeline.sections.pictures import Pictures
from pipeline.sections.town import Town
from pipeline.sections.train import Train


def main(params: Path = Path("params.yaml")) -> None:
    """Read every section; build every model once, so that a network that cannot be is found now, and look for weights.

    Nothing is fetched, and no file of weights is opened.
    """
    for section in (Town, Ingest, Labels, Perception, Clouds, Pictures, Train, Evaluate):
        load(section, params)
    encoder, image_size = load(Encoder, params), load(Ingest, params).image_size
    variants = {name: load_entry(Variant, "graphs", name, params) for name in names("graphs", params)}
    lines = {name: load_entry(Model, "models", name, params) for name in names("models", params)}
    for name, line in lines.items():
        if line.input not in variants:
            near = closest(line.input, list(variants))
            raise InputError(f"{params}: models.{name}.input = {line.input!r} is no variant of graphs: {near}")

    import torch

    from models.encoder import unified_encoder
    from models.steering.core import steering_net

    networks: list[Encoder | Teacher] = [encoder, encoder.teacher] if encoder.teacher else [encoder]
    for network in networks:
        if network.backbone == precomputed.BACKBONE:
            precomputed.find(Path(str(network.weights)))
            continue
        key = f"{network.key}.backbone"
        if network.backbone not in unified_encoder.BACKBONES:
            near = closest(network.backbone, [*unified_encoder.BACKBONES, precomputed.BACKBONE])
            raise InputError(f"{params}: {key} = {network.backbone!r} is none of this project: {near}")
        try:
            with torch.device("meta"):  # takes neither memory nor time
                unified_encoder.UnifiedEncoder(network.backbone)
        except ValueError as error:
            raise InputError(f"{params}: {key} = {network.backbone}: {error}") from error
        for name, file in weights.files(network.weights, f"{network.key}.weights").items():
            weights.locate(file, name)
    for name, line in lines.items():
        try:
            variant = variants[line.input]
            steering_net.build(line.model_dump(), variant.kind, len(variant.levels), image_size)
        except ValueError as error:
            raise InputError(f"{params}: models.{name}: {error}") from error


if __name__ == "__main__":
    console.run(main)
