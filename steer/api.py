"""Use the commands `steer measure` and `steer predict` from Python.

from steer.api import measure

drive = measure("street.mp4", fov_deg=65)
drive.table  # pandas, a row per frame
drive.notes, drive.doubts  # for the user
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from footage.settings import Options
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.base.params import from_python
from pipeline.encoder.encoder_file import FILE
from pipeline.train.trained import load_model
from steer import measure as measuring
from steer.outcome import Outcome
from steer.street_encoder import encoder_folder

PathLike = Path | str
# Videos in order, or the folder of a drive or of images.
Paths = PathLike | Sequence[PathLike]


@contextmanager
def _usual_torch_state() -> Iterator[None]:
    """Use torch's usual type of numbers, and restore the caller's type and random state after it.

    Networks get random weights before those of their file.
    """
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_default_dtype(dtype)


@_usual_torch_state()
def measure(
    source: Paths,
    *,
    encoder: PathLike | None = None,
    out: PathLike | None = None,
    video: bool = False,
    wheelbase_m: float = 2.7,
    **options: Any,
) -> Outcome:
    """Measure the motion of a car from the images of its camera.

    `out` is a new or empty folder for motion.csv, track.png, quality.json, the drive to which a
    recording was converted and, if `video` is true, overlay.mp4. If `out` is None, no files are
    kept. `encoder` is the folder of an encoder; if it is None, it is the one that `steer street`
    makes. `options` are those of a recording, :class:`footage.settings.Options`. Raises InputError
    for input that cannot be used.
    """
    given = from_python(Options, options)
    car = from_python(measuring.CarOptions, {"wheelbase_m": wheelbase_m})
    folder = encoder_folder()
    if encoder is not None:
        folder = here_or_included(Path(encoder))
    if not (folder / FILE).is_file():
        fix = "Make one for real streets: steer street. Or pass --encoder"
        raise InputError("no encoder", folder, fix)
    return measuring.measure_source(
        _list_paths(source),
        given,
        out=None if out is None else Path(out),
        encoder=folder,
        wheelbase_m=car.wheelbase_m,
        video=video,
    )


@_usual_torch_state()
def predict(
    source: Paths,
    model: PathLike,
    *,
    encoder: PathLike | None = None,
    out: PathLike | None = None,
    video: bool = False,
    **options: Any,
) -> Outcome:
    """Predict the steering angle of each frame with a trained model.

    `model` is the model's folder. `encoder` is the folder of its encoder; if it is None, it is
    data/encoder beside the model's data/train. `options` and `out` are those of :func:`measure`,
    with steering.csv instead of motion.csv. Raises InputError for input that cannot be used.
    """
    given = from_python(Options, options)
    folder = here_or_included(Path(model))
    trained = load_model(folder)
    if encoder is None:
        encoder = _find_encoder(folder)
    return measuring.measure_source(
        _list_paths(source),
        given,
        out=None if out is None else Path(out),
        encoder=Path(encoder),
        model=trained,
        video=video,
    )


def here_or_included(path: Path) -> Path:
    """Return `path` or, if it exists only beside the code, its path there.

    The checkout and the wheel include an encoder and a network of rendered streets.
    """
    included = ROOT / path
    if not path.exists() and included.exists():
        return included
    return path


def _list_paths(source: Paths) -> list[Path]:
    """Return one path or several as a list."""
    if isinstance(source, Path | str):
        return [Path(source)]
    return [Path(path) for path in source]


def _find_encoder(model: Path) -> Path:
    """Return the folder of the encoder that belongs to a model.

    It is data/encoder for a model in data/train/<model>, or in the folder of a seed in it. The
    models of the sample have the encoder of the sample. Raises InputError if the model is
    elsewhere.
    """
    if model.resolve().parent == ROOT / "models/steering":
        return ROOT / "models/encoder/sample"
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent / "encoder"
    fix = "Pass --encoder, the folder of its encoder"
    raise InputError("the model is not in a data/train", model, fix)
