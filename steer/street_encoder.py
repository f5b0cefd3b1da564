"""Make the encoder of real streets, which `steer measure` uses by default."""

from collections.abc import Sequence
from pathlib import Path

from platformdirs import user_cache_path

from pipeline.base.checkout import ROOT, is_checkout
from pipeline.encoder.create import create_street
from pipeline.encoder.encoder_file import save_encoder
from pipeline.encoder.weights import WEIGHTS


def weights_folder() -> Path:
    """Return the folder for downloaded weights: that of the checkout, or else the user's cache."""
    if is_checkout():
        return ROOT / WEIGHTS
    return user_cache_path("semantic-steering")


def encoder_folder() -> Path:
    """Return the folder of the encoder of real streets, even if it has not been made yet."""
    return weights_folder() / "street"


def make_encoder() -> Sequence[str]:
    """Write the encoder of real streets, and return the URLs and terms of its published weights.

    Weights that are missing are downloaded. Raises InputError if a download fails.
    """
    architecture, model = create_street(weights_folder())
    folder = encoder_folder()
    folder.mkdir(parents=True, exist_ok=True)
    save_encoder(folder, architecture, model.state_dict())
    return architecture["sources"]
