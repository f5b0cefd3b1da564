"""Create the encoder of section ``encoder``, and load or download its weights."""

import sys
from pathlib import Path

from torch import hub, nn

from models.encoder import hugging_face, street
from models.encoder.unified_encoder import Architecture, build_network
from pipeline.base.checkout import in_checkout
from pipeline.base.errors import InputError, error_context
from pipeline.base.hashes import file_hash
from pipeline.encoder import precomputed
from pipeline.encoder.encoder_file import load_encoder
from pipeline.encoder.settings import NEEDED, Encoder
from pipeline.encoder.weights import WEIGHTS, find_weights, weights_hash


def create_encoder(settings: Encoder) -> tuple[Architecture, nn.Module]:
    """Return the encoder of section ``encoder``: its description and its network.

    Raises InputError if a file is missing, or is not the file that the section describes.
    """
    with error_context("weights"):
        if settings.weights_sha256 and settings.weights_sha256 != weights_hash(settings):
            raise InputError("weights_sha256 is the hash of other weights", fix="Repeat make NAME")
    if settings.weights is None or settings.backbone == "precomputed":
        return _build_encoder(settings)
    with error_context("weights"):
        architecture, model = load_encoder(find_weights(settings.weights))
        backbone = architecture["backbone"]
        if backbone != settings.backbone:
            problem = f"backbone is {backbone!r}, expected {settings.backbone!r}"
            raise InputError(problem, settings.weights, "Name another file")
    return architecture, model


def create_street(weights: Path) -> tuple[Architecture, nn.Module]:
    """Return the encoder of real streets: its description and its network.

    Published files that are missing below the folder `weights` are downloaded. The description has
    their URLs and terms of use as ``sources``. Raises InputError if a download fails.
    """
    for path, (url, sha256, _) in street.SOURCES.items():
        download_file(weights / path, url, sha256)
    model = street.Street()
    model.load_published(weights)
    sources = [f"{path}: {url} ({terms})" for path, (url, _, terms) in street.SOURCES.items()]
    return {"backbone": "street", "sources": sources}, model


def check_encoder(settings: Encoder) -> None:
    """Raise InputError if a file, a folder or a package is missing.

    Hugging Face's hub is not asked.
    """
    if settings.backbone in NEEDED:
        with error_context("backbone"):
            hugging_face.import_transformers()
    if settings.weights:
        with error_context("weights"):
            if settings.backbone == "precomputed":
                precomputed.find_images(in_checkout(settings.weights))
            else:
                find_weights(settings.weights)
        return
    for key in NEEDED.get(settings.backbone, ()):
        value = getattr(settings, key)
        if isinstance(value, str):
            with error_context(key):
                hugging_face.check_network(value)


def _build_encoder(settings: Encoder) -> tuple[Architecture, nn.Module]:
    """Return description and network of a section that names no encoder.pt.

    If published weights or files are loaded, the description has their `sources`, a text for each.
    """
    match settings.backbone:
        case "street":
            return create_street(in_checkout(WEIGHTS))
        case "pair":
            assert settings.depth, "checked by section encoder"
            assert settings.classes, "checked by section encoder"
            assert settings.focal_by_width, "checked by section encoder"
            return hugging_face.create_pair(
                settings.depth, settings.classes, focal_by_width=settings.focal_by_width
            )
        case "hugging_face":
            assert settings.model, "checked by section encoder"
            return hugging_face.create_backbone(settings.model)
        case "precomputed":
            assert settings.weights, "checked by section encoder"
            count, sha256 = precomputed.hash_images(in_checkout(settings.weights))
            architecture = {
                "backbone": "precomputed",
                "folder": str(settings.weights),
                "sha256": sha256,
                "sources": [f"{count} PNG files in {settings.weights}"],
            }
            return architecture, nn.Module()
        case backbone:
            return {"backbone": backbone}, build_network({"backbone": backbone})


def download_file(path: Path, url: str, sha256: str) -> None:
    """Download a file to `path`, unless it is there already.

    Raises InputError if the download fails, or if the file has another SHA-256.
    """
    if path.exists():
        actual = file_hash(path)
        if actual != sha256:
            problem = f"SHA-256 is {actual}, expected {sha256}"
            raise InputError(problem, path, "Delete it to download it again")
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        hub.download_url_to_file(url, str(path), sha256, progress=sys.stderr.isatty())
    except (OSError, RuntimeError) as error:
        fix = f"Put the file there: curl --create-dirs -L -o {path} {url}"
        raise InputError(f"cannot download {url} ({error})", path, fix) from error
