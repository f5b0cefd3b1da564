"""Use the commands `steer measure`, `steer predict` and `steer export` from Python.

from steer.api import measure

drive = measure("street.mp4", fov_deg=65)
drive.table  # pandas, a row per frame
drive.notes, drive.doubts  # for the user
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.outputs import check_free
from pipeline.base.params import from_python
from pipeline.base.resume import ROOT
from pipeline.encoder.encoder_file import FILE
from pipeline.ingest.settings import RecordingOptions
from pipeline.labels.label import Car
from pipeline.train.trained import load_model
from steer import export as exporting
from steer import measure as measuring
from steer import predict as predicting
from steer.chain import open_source
from steer.outcome import Outcome
from steer.parameters import MeasureOptions
from steer.street_encoder import encoder_folder

PathLike = Path | str
# Videos in order, or the folder of a KITTI drive, of images or of videos.
Paths = PathLike | Sequence[PathLike]


def measure(
    source: Paths,
    *,
    encoder: PathLike | None = None,
    out: PathLike | None = None,
    video: bool = False,
    **options: Any,
) -> Outcome:
    """Measure the motion of a car from the images of its camera.

    `out` is a new or empty folder for motion.csv, track.png, quality.json and, if `video` is true,
    overlay.mp4. If `out` is None, no files are written. `encoder` is the folder of an encoder; if
    it is None, it is the one that `steer street` makes. `options` are those of
    :class:`steer.parameters.MeasureOptions`. Raises InputError for input that cannot be used.
    """
    given = from_python(MeasureOptions, options)
    target = _free(out)
    folder = encoder_folder()
    if encoder is not None:
        folder = here_or_included(Path(encoder))
    if not (folder / FILE).is_file():
        fix = "Make one for real streets: steer street. Or pass --encoder"
        raise InputError("no encoder", folder, fix)
    opened = open_source(_paths(source), measuring.READING, given)
    car = Car(given.wheelbase_m, min_speed_mps=1.0)
    return measuring.measure(opened, target, folder, car, video=video)


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

    `model` is the model's folder, or runs/NAME. `encoder` is the folder of its encoder; if it is
    None, it is data/encoder beside the model's data/train. `options` are those of
    :class:`pipeline.ingest.settings.RecordingOptions`. `out` is a folder as in :func:`measure`, for
    steering.csv, track.png and overlay.mp4. Raises InputError for input that cannot be used.
    """
    given = from_python(RecordingOptions, options)
    target = _free(out)
    folder = _network(here_or_included(Path(model)))
    trained = load_model(folder)
    opened = open_source(_paths(source), predicting.reading(trained), given, trained.fps)

    # If no height of the camera is known, it is that of the training drives.
    height_m = trained.settings.get("camera_height_m")
    if height_m and not opened.camera.height_known:
        opened = opened.at_height(height_m)
        note = f"camera {height_m:g} m over the road, as in the model's training drives"
        opened.drive.notes.insert(0, note)
    drives = trained.drives[0]
    if len(trained.drives) > 1:
        drives = f"{len(trained.drives)} drives: {drives} to {trained.drives[-1]}"
    opened.drive.notes.insert(0, f"{trained.name} was trained on {drives}")

    if encoder is None:
        encoder = _encoder_beside(folder)
    return predicting.predict(trained, opened, target, Path(encoder), video=video)


def export(file: PathLike, frame: int, out: PathLike) -> str:
    """Write the points of a frame to `out`, a new PLY or PCD file, and return what it holds.

    `file` is a drive's file of clouds, graphs or scans, see :func:`steer.export.export`.
    """
    return exporting.export(Path(file), frame, Path(out))


def _free(out: PathLike | None) -> Path | None:
    """Return the path of a new or empty folder, or None. Raises InputError if it has files."""
    if out is None:
        return None
    check_free(Path(out))
    return Path(out)


def here_or_included(path: Path) -> Path:
    """Return `path` or, if it exists only beside the code, its path there.

    The checkout and the wheel include an encoder and a network of rendered streets.
    """
    included = ROOT / path
    if not path.exists() and included.exists():
        return included
    return path


def _paths(source: Paths) -> list[Path]:
    """Return one path or several as a list."""
    if isinstance(source, Path | str):
        return [Path(source)]
    return [Path(path) for path in source]


def _network(model: Path) -> Path:
    """Return the folder of a model: that of the only model if `model` is runs/NAME, else `model`.

    Raises InputError if runs/NAME has several models.
    """
    networks = sorted(path.parent for path in (model / "data/train").glob("*/best.pt"))
    if not networks:
        return model
    if len(networks) > 1:
        names = ", ".join(str(network) for network in networks)
        raise InputError("has several models", model, f"Pass one as --model: {names}")
    return networks[0]


def _encoder_beside(model: Path) -> Path:
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
