"""Measure and predict from Python, as the commands `steer measure` and `steer predict` do.

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
from steer import measure as measuring
from steer import predict as predicting
from steer.chain import open_source
from steer.outcome import Outcome
from steer.parameters import MeasureOptions

PathLike = Path | str
# Videos in order, or the folder of a KITTI drive, of images or of videos.
Paths = PathLike | Sequence[PathLike]


def measure(
    source: Paths,
    *,
    encoder: PathLike = "weights/street",
    out: PathLike | None = None,
    video: bool = False,
    **options: Any,
) -> Outcome:
    """Measure the motion of a car from the images of its camera.

    `out` is a new or empty folder for motion.csv, track.png, quality.json and, with `video`,
    overlay.mp4; None: no files. `options` are those of :class:`steer.parameters.MeasureOptions`.
    Raises InputError for input that cannot be used.
    """
    given = from_python(MeasureOptions, options)
    target = _free(out)
    folder = here_or_in_checkout(Path(encoder))
    if not (folder / FILE).is_file():
        fix = "Make one for real streets: make street. Or pass --encoder"
        raise InputError("no encoder", encoder, fix)
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
    """Predict the steering angle of each frame by a trained model: its folder, or runs/NAME.

    `encoder` is its folder; None: data/encoder beside the model's data/train. `options` are those
    of :class:`pipeline.ingest.settings.RecordingOptions`. `out` and errors are those of
    :func:`measure`.
    """
    given = from_python(RecordingOptions, options)
    target = _free(out)
    folder = _network(here_or_in_checkout(Path(model)))
    trained = load_model(folder)
    opened = open_source(_paths(source), predicting.reading(trained), given, trained.fps)

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


def _free(out: PathLike | None) -> Path | None:
    if out is None:
        return None
    check_free(Path(out))
    return Path(out)


def here_or_in_checkout(path: Path) -> Path:
    """Return the path, or if it does not exist, the same path below the checkout."""
    in_checkout = ROOT / path
    if not path.exists() and in_checkout.exists():
        return in_checkout
    return path


def _paths(source: Paths) -> list[Path]:
    if isinstance(source, Path | str):
        return [Path(source)]
    return [Path(path) for path in source]


def _network(model: Path) -> Path:
    """Return the folder of the only network of runs/NAME, or the folder itself.

    Raises InputError if there are more.
    """
    networks = sorted(path.parent for path in (model / "data/train").glob("*/best.pt"))
    if not networks:
        return model
    if len(networks) > 1:
        names = ", ".join(str(network) for network in networks)
        raise InputError("has several models", model, f"Pass one as --model: {names}")
    return networks[0]


def _encoder_beside(model: Path) -> Path:
    """Return data/encoder of a model data/train/<model> or a seed's folder in it; or the sample's.

    Raises InputError if the model is elsewhere.
    """
    if model.resolve() == ROOT / "models/steering/sample":
        return ROOT / "models/encoder/sample"
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent / "encoder"
    fix = "Pass --encoder, the folder of its encoder"
    raise InputError("the model is not in a data/train", model, fix)
