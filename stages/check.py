"""Stage check: find faults of params.yaml before any other stage runs. It reads no weights and has no outputs."""

from pathlib import Path

from pipeline.base import console
from pipeline.base.errors import error_context
from pipeline.base.params import parse, read
from pipeline.check.check_code import check_code
from pipeline.check.check_model import check_model
from pipeline.check.settings import Params
from pipeline.encoder import create


def main(params: Path = Path("params.yaml")) -> Path:
    """Validate all sections and imports, build each steering network once, and look for the encoder's files.

    Returns `params`.
    """
    settings = parse(Params, read(params), path=params)
    check_code(settings)
    with error_context(params):
        with error_context("encoder"):
            create.check(settings.encoder)
        for name, model in settings.models.items():
            with error_context(f"models.{name}"):
                check_model(model, settings)
    return params


if __name__ == "__main__":
    console.run(main)
