"""Measure the motion of a car in a drive or a recording, and predict with a model if given."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
from pydantic import Field

from pipeline.jobs.outputs import check_free

from footage.convert import USUAL_HZ
from footage.settings import Options
from pipeline.base.params import Section
from pipeline.base.store import replacing, write_json
from pipeline.ingest.settings import Reading
from pipeline.labels.label import Car
from pipeline.labels.settings import Wheelbase
from pipeline.perception.perceive import find_warnings
from pipeline.perception.settings import Perception
from pipeline.train.trained import Trained
from steer import predict
from steer.chain import INGEST, open_source, run_chain
from steer.measurement import find_drive, save_measurement
from steer.outcome import Outcome, Results, comparison_lines
from steer.pictures import draw_track, write_overlay

# Settings for reading a source. Images get the size with which the encoder was trained. The first
# of these cameras that has images is read.
READING = Reading(image_size=(192, 640), cameras=[2, 0, 3, 1], lidar=False, on_damaged="skip")


class CarOptions(Section):
    """Options of the car, with the limits of section labels and the option's name as alias."""

    wheelbase_m: Wheelbase = Field(default=2.7, alias="wheelbase")


def measure_source(
    paths: Sequence[Path],
    options: Options,
    *,
    out: Path | None,
    encoder: Path,
    wheelbase_m: float = 2.7,
    model: Trained | None = None,
    video: bool,
) -> Outcome:
    """Measure a source, and write the table, track.png, quality.json and overlay.mp4.

    The source is the folder of a drive, or a recording, which is converted to ``out/drive`` first.
    The table is motion.csv, or with a `model` steering.csv, which also has its predictions
    and measured motion that does not depend on later frames. `out` is a new or empty folder; if it
    is None, no files are kept. overlay.mp4 is written only if `video` is true. `encoder` is the
    folder of an encoder. Raises InputError if the source cannot be used, or lacks an input of the
    model.
    """
    if out is not None:
        check_free(out)
    reading = READING
    perception = Perception(batch=4)
    hz = USUAL_HZ
    car = Car(wheelbase_m, min_speed_mps=1.0)
    if model:
        reading = predict.reading_settings(model)
        perception = predict.perception_settings(model)
        hz = model.fps
        car = model.quantity.car

    # An output folder of `steer measure` stands for its drive.
    earlier = paths[0] if len(paths) == 1 else None
    if earlier:
        paths = [find_drive(earlier)]

    with _open_folders(out) as (results_folder, work):
        source = open_source(
            paths, reading=reading, options=options, folder=results_folder / "drive", hz=hz
        )
        if model:
            source = predict.adapt_source(model, source)
        measurement = run_chain(
            source,
            work,
            reading=reading,
            perception=perception,
            encoder=encoder,
            earlier=earlier,
        )

        results = Results.read(source, work, measurement.facts, car, smooth=model is None)
        results.doubts += find_warnings(encoder, "float32", [work / INGEST])
        comparison = results.compare_angles("measured")
        if model:
            predict.add_prediction(model, source, work, results)
            results.doubts += predict.find_differences(
                model, source, encoder, results.table["time_s"]
            )
            comparison = results.compare_angles("predicted", model.entry.horizon)
        results.notes += comparison_lines(comparison)

        if out:
            table = "steering.csv" if model else "motion.csv"
            results.write_csv(results_folder / table, source.name)
            draw_track(results_folder / "track.png", source.name, results)
            write_json(
                results_folder / "quality.json", results.describe_quality(source, comparison)
            )
            if model is None:
                folder = source.files.folder
                save_measurement(results_folder, work, measurement.key, measurement.facts, folder)
            if video:
                write_overlay(results_folder / "overlay.mp4", source, results, car.wheelbase_m)
    files = sorted(out.iterdir()) if out else []
    frame = pd.DataFrame({"drive": source.name, **results.table})
    return Outcome(frame, notes=results.notes, doubts=results.doubts, files=files)


@contextmanager
def _open_folders(out: Path | None) -> Iterator[tuple[Path, Path]]:
    """Yield a folder that becomes `out` if the block succeeds, and one for temporary files.

    Both are on the same disk.
    """
    if out is None:
        with TemporaryDirectory() as results, TemporaryDirectory() as work:
            yield Path(results), Path(work)
        return
    with replacing(out) as results_folder:
        results_folder.mkdir()
        with TemporaryDirectory(dir=results_folder.parent) as work:
            yield results_folder, Path(work)
