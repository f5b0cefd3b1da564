"""Stage check: find faults of params.yaml before any other stage runs. It reads no weights and has
no outputs.
"""

from pathlib import Path
from typing import Any

from pipeline.base import console
from pipeline.base.errors import error_context
from pipeline.base.params import parse, read
from pipeline.check.check_code import check_code
from pipeline.check.check_model import check_model
from pipeline.check.settings import Params
from pipeline.encoder import create


def main(params: Path = Path("params.yaml")) -> Path:
    """Validate all sections and imports, build each steering network once, and look for the
    encoder's files.

    Returns `params`.
    """
    content = read(params)
    settings = parse(Params, content, path=params)
    check_code(settings)
    with error_context(params):
        if not has_encoder(params.with_name("dvc.lock"), content["encoder"]):
            with error_context("encoder"):
                create.check(settings.encoder)
        for name, model in settings.models.items():
            with error_context(f"models.{name}"):
                check_model(model, settings)
    return params


def has_encoder(lock: Path, settings: dict[str, Any]) -> bool:
    """Return whether dvc.lock has an encoder of these settings: DVC takes or fetches it, as if its
    files were here.
    """
    if not lock.is_file():
        return False
    encoder = read(lock).get("stages", {}).get("encoder", {})
    return encoder.get("params", {}).get("params.yaml", {}).get("encoder") == settings


if __name__ == "__main__":
    console.run(main)
