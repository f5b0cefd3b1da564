"""Find and hash the files that section encoder names."""

from pathlib import Path

from pipeline.base.checkout import in_checkout
from pipeline.base.errors import InputError
from pipeline.base.hashes import content_hash, digest, file_hash
from pipeline.encoder import precomputed
from pipeline.encoder.settings import Encoder

# Folder of the checkout for downloaded files. make street writes to its subfolder street.
WEIGHTS = Path("weights")


def weights_hash(settings: Encoder) -> str | None:
    """Return the SHA-256 of the files and folders of the encoder, or None if it names none.

    The published files of backbone street are not named: their hashes are part of the code. Raises
    InputError if the weights are missing.
    """
    if settings.backbone == "precomputed" and settings.weights:
        _, sha256 = precomputed.hash_images(in_checkout(settings.weights))
        return sha256
    if settings.weights:
        return file_hash(find_weights(settings.weights))
    # A network is a folder, or has a name on Hugging Face's hub.
    networks = [settings.depth, settings.classes, settings.model]
    folders = [in_checkout(Path(name)) for name in networks if name]
    hashes = [content_hash(folder) for folder in folders if folder.is_dir()]
    return digest(hashes) if hashes else None


def find_weights(weights: Path) -> Path:
    """Return the path of a file of the checkout. Raises InputError if it is missing."""
    path = in_checkout(weights)
    if not path.is_file():
        fix = "Put it there, or name another one"
        if weights.parent == WEIGHTS / "street":
            fix = "Make it: make street"
        raise InputError("file is missing", weights, fix)
    return path
