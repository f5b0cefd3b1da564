"""What the commands `steer measure` and `steer predict` do, from Python.

from steer.api import measure drive = measure("street.mp4", fov_deg=65)  # drive.table: pandas, a
row per frame; drive.doubts, drive.notes
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
# videos in order, or a folder: of a KITTI drive, of images or of videos
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

    `out`: a new or empty folder for motion.csv, track.png, quality.json and, with `video`,
    overlay.mp4; None: no files. `options`: of :class:`steer.parameters.MeasureOptions`. Raises
    InputError for input that cannot be used.
    """
    known = from_python(MeasureOptions, options)
    target, folder = _free(out), here_or_in_checkout(Path(encoder))
    if not (folder / FILE).is_file():
        raise InputError(
            "no encoder", encoder, "Make one for real streets: make street. Or pass --encoder"
        )
    opened = open_source(_paths(source), measuring.READING, known)
    return measuring.measure(
        opened, target, folder, Car(known.wheelbase_m, min_speed_mps=1.0), video=video
    )


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

    `encoder`: its folder; None: data/encoder beside the model's data/train. `options`: of a
    recording, see :class:`pipeline.ingest.settings.RecordingOptions`. `out`, errors: as of
    :func:`measure`.
    """
    known = from_python(RecordingOptions, options)
    target, folder = _free(out), _network(here_or_in_checkout(Path(model)))
    trained = load_model(folder)
    opened = open_source(_paths(source), predicting.reading(trained), known, trained.fps)
    if (height_m := trained.settings.get("camera_height_m")) and not opened.camera.height_known:
        opened = opened.at_height(height_m)
        opened.drive.notes.insert(
            0, f"camera {height_m:g} m over the road, as in the model's training drives"
        )
    names = trained.drives
    trained_on = f"{len(names)} drives: {names[0]} to {names[-1]}" if len(names) > 1 else names[0]
    opened.drive.notes.insert(0, f"{trained.name} was trained on {trained_on}")
    return predicting.predict(
        trained, opened, target, Path(encoder or _encoder_beside(folder)), video=video
    )


def _free(out: PathLike | None) -> Path | None:
    if out is not None:
        check_free(Path(out))
    return None if out is None else Path(out)


def here_or_in_checkout(path: Path) -> Path:
    """Return the path, or where it does not exist, the same path below the checkout, if that
    exists.
    """
    return ROOT / path if not path.exists() and (ROOT / path).exists() else path


def _paths(source: Paths) -> list[Path]:
    return [Path(path) for path in ([source] if isinstance(source, Path | str) else source)]


def _network(model: Path) -> Path:
    """Return the folder of the only network of runs/NAME, or the folder itself. Raises InputError
    if there are more.
    """
    networks = sorted(path.parent for path in (model / "data/train").glob("*/best.pt"))
    if len(networks) > 1:
        raise InputError(
            "has several models", model, f"Pass one as --model: {', '.join(map(str, networks))}"
        )
    return networks[0] if networks else model


def _encoder_beside(model: Path) -> Path:
    """Return data/encoder of a model data/train/<model>, or of the folder of a seed in it; or the
    sample's.
    """
    if model.resolve() == ROOT / "models/steering/sample":
        return ROOT / "models/encoder/sample"
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent / "encoder"
    raise InputError(
        "the model is not in a data/train", model, "Pass --encoder, the folder of its encoder"
    )
