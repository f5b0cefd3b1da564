"""What the commands `steer measure` and `steer predict` do, from Python.

from steer.api import measure
drive = measure("street.mp4", fov_deg=65)  # drive.table: pandas, a row per frame; drive.doubts, drive.notes
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from pipeline.base.errors import InputError, closest
from pipeline.base.outputs import check_free
from pipeline.base.resume import ROOT
from pipeline.encoder.encoder_file import FILE
from pipeline.ingest.datasets.recording import Capture
from pipeline.ingest.log import Logs
from pipeline.ingest.settings import Reading
from pipeline.labels.label import Car
from pipeline.train.trained import load
from steer import measure as measuring
from steer import predict as predicting
from steer.chain import Source, open_source
from steer.outcome import Outcome

PathLike = Path | str
Recording = PathLike | Sequence[PathLike]  # videos in order, or a folder: of a KITTI drive, of images or of videos


class Options(TypedDict, total=False):
    """What is known about a recording, see docs/real.md; None as if not given."""

    fov_deg: float | None  # horizontal
    K: str | Sequence[float] | None  # fx, fy, cx, cy in pixels; distortion, fisheye: also as text or numbers
    distortion: str | Sequence[float] | None  # k1, k2, p1, p2[, k3]
    fisheye: str | Sequence[float] | None  # k1, k2, k3, k4
    fps: float | None
    times: PathLike | None
    camera_height_m: float | None
    wheel: PathLike | None
    steering_ratio: float | None
    motion: PathLike | None
    offset_s: float  # seconds to add to the times of logs


def measure(
    source: Recording,
    *,
    encoder: PathLike = "weights/street",
    wheelbase_m: float = 2.7,
    out: PathLike | None = None,
    video: bool = False,
    **known: Unpack[Options],
) -> Outcome:
    """Measure the motion of a car from the images of its camera.

    `out`: a new or empty folder for motion.csv, track.png, quality.json and, with `video`, overlay.mp4; None: no files.
    Raises InputError for input that cannot be used.
    """
    target, folder = _free(out), here_or_in_checkout(Path(encoder))
    if not (folder / FILE).is_file():
        raise InputError("no encoder", encoder, "Make one for real streets: make street. Or pass --encoder")
    opened = _open(source, measuring.READING, known)
    return measuring.measure(opened, target, folder, Car(wheelbase_m, min_speed_mps=1.0), video=video)


def predict(
    source: Recording,
    model: PathLike,
    *,
    encoder: PathLike | None = None,
    out: PathLike | None = None,
    video: bool = False,
    **known: Unpack[Options],
) -> Outcome:
    """Predict the steering angle of each frame by a trained model: its folder, or runs/NAME.

    `encoder`: its folder; None: data/encoder beside the model's data/train. `out`, errors: as of :func:`measure`.
    """
    target, folder = _free(out), _network(here_or_in_checkout(Path(model)))
    trained = load(folder)
    opened = _open(source, predicting.reading(trained), known, trained.fps)
    if (height_m := trained.settings.get("camera_height_m")) and not opened.camera.height_known:
        opened = opened.at_height(height_m)
        opened.drive.notes.insert(0, f"camera {height_m:g} m over the road, as in the model's training drives")
    names = trained.drives
    trained_on = f"{len(names)} drives: {names[0]} to {names[-1]}" if len(names) > 1 else names[0]
    opened.drive.notes.insert(0, f"{trained.name} was trained on {trained_on}")
    return predicting.predict(trained, opened, target, Path(encoder or _encoder_beside(folder)), video=video)


def _free(out: PathLike | None) -> Path | None:
    if out is not None:
        check_free(Path(out))
    return None if out is None else Path(out)


def here_or_in_checkout(path: Path) -> Path:
    """Return the path, or where it does not exist, the same path below the checkout, if that exists."""
    return ROOT / path if not path.exists() and (ROOT / path).exists() else path


def _open(source: Recording, reading: Reading, known: Options, hz: float | None = None) -> Source:
    if unknown := known.keys() - Options.__annotations__.keys():
        raise TypeError(f"unknown option {min(unknown)!r}: {closest(min(unknown), [*Options.__annotations__])}")
    files = known.get("wheel"), known.get("motion"), known.get("times")
    wheel, motion, times = (Path(file) if file else None for file in files)
    logs = Logs.read(wheel, known.get("steering_ratio"), motion, known.get("offset_s", 0.0))
    K, distortion, fisheye = (_text(known.get(name)) for name in ("K", "distortion", "fisheye"))
    paths = [Path(path) for path in ([source] if isinstance(source, Path | str) else source)]
    capture = Capture(known.get("fov_deg"), K, distortion, fisheye, known.get("fps"), times)
    return open_source(paths, reading, known.get("camera_height_m"), logs, hz, capture)


def _text(numbers: Any) -> str | None:
    return numbers if numbers is None or isinstance(numbers, str) else ",".join(map(str, numbers))


def _network(model: Path) -> Path:
    """Return the folder of the only network of runs/NAME, or the folder itself. Raises InputError if there are more."""
    networks = sorted(path.parent for path in (model / "data/train").glob("*/best.pt"))
    if len(networks) > 1:
        raise InputError("has several models", model, f"Pass one as --model: {', '.join(map(str, networks))}")
    return networks[0] if networks else model


def _encoder_beside(model: Path) -> Path:
    """Return data/encoder of a model data/train/<model>, or of the folder of a seed in it; or the sample's."""
    if model.resolve() == ROOT / "models/steering/sample":
        return ROOT / "models/encoder/sample"
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent / "encoder"
    raise InputError("the model is not in a data/train", model, "Pass --encoder, the folder of its encoder")
