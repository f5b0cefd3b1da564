"""Stage check: find faults of params.yaml before any other stage runs.

It reads no weights and has no outputs.
"""

from pathlib import Path
from typing import Any

from pipeline.jobs import console

from pipeline.base.errors import error_context
from pipeline.base.params import parse, read_yaml
from pipeline.check.check_model import check_model, check_network_folders
from pipeline.check.settings import Params
from pipeline.encoder import create


def main(params: Path = Path("params.yaml")) -> Path:
    """Validate all sections, and run each model's quantity and network once. Return `params`.

    The encoder's files have to exist, unless dvc.lock lists an encoder of these settings.
    """
    content = read_yaml(params)
    settings = parse(Params, content, path=params)
    check_network_folders()
    has_encoder = is_locked(params.with_name("dvc.lock"), content["encoder"])
    with error_context(params):
        if not has_encoder:
            with error_context("encoder"):
                create.check_encoder(settings.encoder)
        for name, model in settings.models.items():
            with error_context(f"models.{name}"):
                check_model(model, settings)
    print(f"{len(settings.models)} models checked")
    return params


def is_locked(lock: Path, encoder: dict[str, Any]) -> bool:
    """Return whether dvc.lock lists an encoder of these settings.

    DVC takes it from its cache, or fetches it, so the files that a fit reads are not needed.
    """
    if not lock.is_file():
        return False
    stages = read_yaml(lock).get("stages", {})
    params = stages.get("encoder", {}).get("params", {})
    return params.get("params.yaml", {}).get("encoder") == encoder


if __name__ == "__main__":
    console.run(main)
