"""Find faults in the whole params file before any stage spends time: it has no outputs."""

from pathlib import Path

from pipeline import console
from pipeline import params as parameters
from pipeline.errors import InputError


def main(params: Path = Path("params.yaml")) -> None:
    """Read every section; build every model once, so that a network that cannot be is found now."""
    parameters.check(params)
    from models import steering_net, unified_encoder

    backbone = parameters.load(parameters.Encoder, params).backbone
    if backbone not in unified_encoder.BACKBONES:
        known = " | ".join(unified_encoder.BACKBONES)
        raise InputError(f"{params}: encoder.backbone = {backbone!r} is none of this project: choose {known}")
    for name in parameters.names("models", params):
        line = parameters.load_entry(parameters.Model, "models", name, params)
        try:
            steering_net.build(line.model_dump())
        except ValueError as error:
            raise InputError(f"{params}: models.{name}: {error}") from error


if __name__ == "__main__":
    console.run(main)
