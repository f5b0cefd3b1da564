"""Create the encoder of section ``encoder``: build it, and load weights that are downloaded once
and verified.
"""

import sys
from collections.abc import Callable
from pathlib import Path

from torch import hub, nn

from models.encoder import hugging_face, street
from models.encoder.unified_encoder import Architecture, build
from pipeline.base.checkout import in_checkout
from pipeline.base.errors import InputError, error_context
from pipeline.base.resume import file_hash
from pipeline.encoder import encoder_file, precomputed
from pipeline.encoder.settings import NEEDED, Encoder
from pipeline.encoder.weights import WEIGHTS, find, weights_hash


def create(settings: Encoder) -> tuple[Architecture, nn.Module]:
    """Return description and network of section ``encoder``. Raises InputError if a file is missing
    or does not fit.
    """
    with error_context("weights"):
        if settings.weights and settings.weights_sha256 not in (None, weights_hash(settings)):
            raise InputError(
                "is not the file whose hash weights_sha256 has",
                settings.weights,
                "Repeat make NAME",
            )
    if settings.weights is None or settings.backbone == "precomputed":
        return CREATE[settings.backbone](settings)
    with error_context("weights"):
        architecture, model = encoder_file.load(find(settings.weights))
        if architecture["backbone"] != settings.backbone:
            problem = f"backbone is {architecture['backbone']!r}, expected {settings.backbone!r}"
            raise InputError(problem, settings.weights, "Name another file")
    return architecture, model


def check(settings: Encoder) -> None:
    """Raise InputError if a file, a folder or a package is missing; the hub is not asked."""
    if settings.backbone in NEEDED:
        with error_context("backbone"):
            hugging_face.transformers()
    if settings.weights:
        with error_context("weights"):
            if settings.backbone == "precomputed":
                precomputed.find(in_checkout(settings.weights))
            else:
                find(settings.weights)
        return
    for key in NEEDED.get(settings.backbone, ()):
        with error_context(key):
            value = getattr(settings, key)
            if isinstance(value, str):
                hugging_face.check(value, key)


def _create_street(settings: Encoder) -> tuple[Architecture, nn.Module]:
    for path, (url, sha256, _) in street.SOURCES.items():
        fetch(in_checkout(WEIGHTS / path), url, sha256)
    model = street.Street()
    model.load_published(in_checkout(WEIGHTS))
    sources = [f"{path}: {url} ({terms})" for path, (url, _, terms) in street.SOURCES.items()]
    return {"backbone": settings.backbone, "sources": sources}, model


def _create_precomputed(settings: Encoder) -> tuple[Architecture, nn.Module]:
    assert settings.weights
    count, sha256 = precomputed.fingerprint(in_checkout(settings.weights))
    architecture = {"backbone": "precomputed", "folder": str(settings.weights), "sha256": sha256}
    return architecture | {"sources": [f"{count} PNG files in {settings.weights}"]}, nn.Module()


CREATE: dict[str, Callable[[Encoder], tuple[Architecture, nn.Module]]] = {
    "small": lambda settings: ({"backbone": "small"}, build({"backbone": "small"})),
    "street": _create_street,
    "pair": hugging_face.create_pair,
    "hugging_face": hugging_face.create_backbone,
    "precomputed": _create_precomputed,
}
"""Kind → its description, with `sources` where weights were published: a line each; and the network
with weights.
"""


def fetch(path: Path, url: str, sha256: str) -> None:
    """Download a file if it is missing. Raises InputError if the download fails or the hash
    differs.
    """
    if path.exists():
        if file_hash(path) != sha256:
            raise InputError(
                f"SHA-256 is {file_hash(path)}, expected {sha256}",
                path,
                "Delete it to download it again",
            )
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        hub.download_url_to_file(url, str(path), sha256, progress=sys.stderr.isatty())
    except (OSError, RuntimeError) as error:
        fix = f"Put the file there: curl --create-dirs -L -o {path} {url}"
        raise InputError(f"cannot download {url} ({error})", path, fix) from error
