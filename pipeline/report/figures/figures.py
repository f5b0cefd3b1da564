"""Which of the paper's figures can be drawn of what is here, and of which frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.report import predicted, street_view
from pipeline.report.figures import drawing, neurons, paths, pruning, wheels
from pipeline.report.predicted import Steering
from pipeline.report.sources import Sources
from pipeline.report.tables import comparison
from pipeline.report.tables.comparison import Result

MOST_MODELS = 4  # whose paths are drawn: the best
PATHS = {"bicycle": "bicycle model", "paper": "the paper's formula, which takes the angle for the heading"}
Frames = dict[str, tuple[str, int]]
"""Kind of bend → drive and KITTI frame number."""


def draw(out: Path, results: Sequence[Result], sources: Sources) -> dict[Path, str]:
    """Draw what can be drawn of the models that say what to steer now; return PNG file → caption.

    `results` are :func:`comparison.in_order`: of the first one's predictions and graphs. Beside each PNG lies an SVG.
    """
    now = [result for result in results if not comparison.horizon(result)]
    if not now:
        return {}
    first = now[0]
    steering = predicted.read(sources.evaluate / first["model"])
    captions = _of_images(out, first["model"], steering, sources)
    structure = sources.evaluate / first["model"] / "structure.json"
    shown = store.read_json(structure, stage=f"evaluate@{first['model']}") if structure.is_file() else {}
    if shown:
        captions[out / "pruning.png"] = _pruning(out / "pruning", first["variant"], shown)
    path = sources.evaluate / first["model"] / "neurons.json"
    if path.is_file() and (told := store.read_json(path, stage=f"evaluate@{first['model']}")):
        neurons.draw(out / "neurons", first["model"], told)
        captions[out / "neurons.png"] = (
            f"The synapses of {first['model']}, and its neurons' states about the sharpest bend of {told['drive']}."
        )
    best = sorted(now, key=lambda result: result["test"]["nmse"])[:MOST_MODELS]
    captions[out / "paths.png"] = _paths(out / "paths", best, sources)
    return captions


def _of_images(out: Path, model: str, steering: dict[str, Steering], sources: Sources) -> dict[Path, str]:
    frames = {
        kind: of for kind, of in _chosen(steering).items() if _holds(sources.ingest / f"{of[0]}.h5", "ingest", of[1])
    }
    if not frames:
        return {}
    shown = []
    for kind, (drive, number) in frames.items():
        of, row = steering[drive], int(np.searchsorted(steering[drive].frame, number))
        with store.DriveReader(sources.ingest / f"{drive}.h5", stage="ingest") as raw:
            image = raw.row("image", raw.row_of(number))
        shown.append(wheels.Shown(f"{kind}: {drive}, {number}", image, of.predicted_deg[row], of.driven_deg[row]))
    captions = {}
    drive, number = next(iter(frames.values()))
    files = [(sources.perception, "perception"), (sources.clouds, "clouds")]
    if all(_holds(folder / f"{drive}.h5", stage, number) for folder, stage in files):
        _street(out / "street", drive, number, sources)
        said = f"Figure 2. {drive}, frame {number}: image, depth, classes, semantic cloud from above."
        captions[out / "street.png"] = said
    wheels.draw(out / "wheels", model, shown)
    captions[out / "wheels.png"] = (
        f"Figure 4. Frames of four kinds of bend, chosen by what {model} predicts: in the green box the steering wheel "
        "as predicted, in the red one as driven."
    )
    return captions


def _chosen(steering: dict[str, Steering]) -> Frames:
    """Return a frame for each kind of bend, of those with both angles."""
    both = [(drive, int(number)) for drive, of in steering.items() for number in of.frame[of.comparable]]
    angles = [of.predicted_deg[of.comparable] for of in steering.values()]
    return {kind: both[row] for kind, row in wheels.chosen(np.concatenate(angles)).items()} if both else {}


def _holds(path: Path, stage: str, number: int) -> bool:
    if not path.is_file():
        return False
    with store.DriveReader(path, stage=stage) as file:
        return bool(np.isin(number, file.frame)) and (stage != "ingest" or "image" in file)


def _street(path: Path, drive: str, number: int, sources: Sources) -> None:
    with (
        store.DriveReader(sources.ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(sources.perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveReader(sources.clouds / f"{drive}.h5", stage="clouds") as cloud,
    ):
        drawing.save(street_view.sheet(drive, [street_view.read_view(raw, perceived, cloud, number)]), path)


def _pruning(path: Path, variant: dict[str, Any], shown: dict[str, Any]) -> str:
    drive, structure = next(iter(shown.items()))
    xyz, cls = np.array(structure["xyz_m"], np.float32), np.array(structure["cls"], np.uint8)
    name, k, share = f"{drive}, frame {structure['frame']}", variant["k"], variant["keep_inter_class"]
    pruning.draw(path, name, xyz, cls, k, share)
    return (
        f"Figure 3. {name}, sampled to {min(pruning.POINTS, len(xyz))} points: its graph of {k} nearest neighbours "
        f"before and after edges between classes are pruned to {share:.0%}."
    )


def _paths(path: Path, results: Sequence[Result], sources: Sources) -> str:
    of_models = {result["model"]: predicted.read(sources.evaluate / result["model"]) for result in results}
    drives, formula = dict.fromkeys(drive for of in of_models.values() for drive in of), results[0]["path"]
    tracks = {
        drive: next(of[drive] for of in of_models.values() if drive in of).track(results[0]["wheelbase_m"], formula)
        for drive in drives
    }
    angles = {
        model: {drive: np.deg2rad(steering.predicted_deg) for drive, steering in of.items()}
        for model, of in of_models.items()
    }
    paths.draw(path, tracks, angles)
    off = ", ".join(
        f"{result['model']} {result['test']['drift_m_per_100m']:.1f} m"
        for result in results
        if result["test"]["drift_m_per_100m"] is not None
    )
    return (
        f"Figure 5. Paths from measured speed and predicted steering ({PATHS[formula]}). Dots: there a path starts "
        "again from the true one, where predictions begin or the driver begins a turn. Off at the end of such a piece, "
        f"per 100 m: {off}."
    )
