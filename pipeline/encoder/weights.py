"""Find and hash the file or folder that the setting encoder.weights names."""

from pathlib import Path

from pipeline.base.checkout import in_checkout
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.encoder import precomputed
from pipeline.encoder.settings import Encoder

# Folder of the checkout for downloaded files. make street writes to its subfolder street.
WEIGHTS = Path("weights")


def weights_hash(settings: Encoder) -> str | None:
    """Return the SHA-256 of the file or of the PNG files, or None if no weights are set.

    Raises InputError if the file or folder is missing.
    """
    if settings.weights is None:
        return None
    if settings.backbone == "precomputed":
        _, sha256 = precomputed.fingerprint(in_checkout(settings.weights))
        return sha256
    return file_hash(find_weights(settings.weights))


def find_weights(weights: Path) -> Path:
    """Return the path of a file of the checkout. Raises InputError if it is missing."""
    path = in_checkout(weights)
    if not path.is_file():
        fix = "Put it there, or name another one"
        if weights.parent == WEIGHTS / "street":
            fix = "Make it: make street"
        raise InputError("file is missing", weights, fix)
    return path
