"""Export a trained network with torch.export: two files, verified on real frames, and a manifest for their use."""

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.graphs import graph_file
from pipeline.live.export_modules import Recurrent, Spatial
from pipeline.train import windows
from pipeline.train.predict import Trained

Arrays = Mapping[str, np.ndarray]
MANIFEST = "export.json"
MAX_DRIVES, WINDOWS_PER_DRIVE = 4, 4
USE = "steering_rad = base_rad + std_rad * recurrent(spatial features of a window, oldest first, ...), left positive"
INPUTS = {
    "image": "uint8 [1, H, W, 3], RGB",
    "xyz": "float32 [points, 3], metres, camera frame: x right, y down, z forward",
    "cls": "uint8 [points], Cityscapes trainId, 255 = void",
    "degree": "uint8 [points], number of neighbours",
    "neighbours": "int64 [points, slots], neighbours of each point, in the first `degree` slots; the others are 0",
    "centres_": "int64 [centres], indices of points, or of centres of the previous level",
    "neighbours_": "int64 [centres, n], the same for the points in the ball around each centre",
    "features": "float32 [1, window, features]",
    "dt_s": "float32 [1, window], seconds since the previous frame, 0.1 for the first",
    "motion": "float32 [1, window, 4]: measured steering angle in rad, yaw_rate_radps, speed_mps, valid (0 or 1)",
}


class Example(NamedTuple):
    """A real window and the network's own results for it."""

    drive: str
    frames: list[Arrays]  # of the spatial part
    window: Arrays  # of the recurrent part; `features` are the expected results of the spatial part
    output: float


def export(model: Trained, graphs: Path, out: Path, tolerance: float) -> dict[str, Any]:
    """Write spatial.pt2, recurrent.pt2 and export.json; return the content of the latter.

    Args:
        model: on the CPU.
        graphs: folder of the graph variant that the model was trained on.
        out: new, empty, or an earlier export, which is replaced when both files are verified.
        tolerance: largest difference from the network's features and outputs, both about 1 in size.
    Raises:
        InputError: `out` contains other files, the network cannot be exported, or a file differs by more.
    """
    if out.exists() and not (out / MANIFEST).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("the path exists and is not an earlier export", out, "Choose a new folder: --out")
    model.net.requires_grad_(False)
    examples = read_examples(model, graphs)
    modules = {"spatial": Spatial(model.net, model.contents.kind), "recurrent": Recurrent(model.net, model.window)}
    calls: dict[str, list[tuple[Arrays, Any]]] = {  # inputs and expected results
        "spatial": [call for each in examples for call in zip(each.frames, each.window["features"][0], strict=True)],
        "recurrent": [(each.window, each.output) for each in examples],
    }
    differences = {}
    with replacing(out) as tmp:
        tmp.mkdir()
        for name, module in modules.items():
            where = f"{name} part of model {model.name}"
            with _exporting(where):
                tensors = tuple(torch.from_numpy(array) for array in calls[name][0][0].values())
                sizes = tuple(dict.fromkeys(range(tensor.ndim), torch.export.Dim.AUTO) for tensor in tensors)
                dynamic = (sizes,) if name == "spatial" else None  # windows have a fixed size
                program = torch.export.export(module, tensors, dynamic_shapes=dynamic, strict=False)
                torch.export.save(program, tmp / f"{name}.pt2")
                differences[name] = _largest_difference(tmp / f"{name}.pt2", calls[name])
            if not differences[name] <= tolerance:  # also for NaN
                problem = f"the exported program differs by {differences[name]:.2g} (tolerance {tolerance:.2g})"
                raise InputError(problem, where, "Intended? Raise --tolerance")
        manifest = {
            "model": {"name": model.name, "seed": model.seed, "fold": model.fold, "line": model.line},
            "use": USE,
            "base_rad": "measured angle of the last frame" if model.net.motion else "0",
            "window": model.window,
            "horizon": model.horizon,
            **vars(model.target),
            "inputs": {
                part: {name: INPUTS[name.rstrip("0123456789")] for name in arrays}
                for part, ((arrays, _), *_) in calls.items()
            },
            "verified": {"windows": len(examples), "drives": list(dict.fromkeys(each.drive for each in examples))},
            "largest_difference": differences,
            "torch": torch.__version__,
        }
        store.write_json(tmp / MANIFEST, manifest, sort_keys=False)
    return manifest


def read_examples(model: Trained, graphs: Path) -> list[Example]:
    """Read windows of some drives, test drives first, evenly spread over each. Raises InputError without any."""
    splits = store.read_index(graphs, stage="graphs")
    drives = [drive for split in reversed(SPLITS) for drive in store.drives_in(splits, split)]
    examples: list[Example] = []
    for drive in drives[:MAX_DRIVES]:
        with graph_file.open_graphs(graphs / f"{drive}.h5") as file:
            examples += _read_drive(model, drive, file)
    if not examples:
        raise InputError(f"no window of {model.window} consecutive frames for verification", graphs)
    return examples


def _read_drive(model: Trained, drive: str, graphs: graph_file.Graphs) -> Iterator[Example]:
    steering_rad = model.predict(graphs)
    timeline = windows.Timeline.read(graphs, model.line["motion"], model.target.car)
    ends = np.flatnonzero(~np.isnan(steering_rad))
    for end in ends[np.linspace(0, len(ends) - 1, min(WINDOWS_PER_DRIVE, len(ends))).round().astype(int)].tolist():
        span = windows.Span(0, end - model.window + 1, end + 1)
        (batch,) = windows.batches([timeline], [[span]], model.window, {0: graphs})
        with torch.inference_mode():
            window = {"features": model.net.encode(model.net.frames(batch)).numpy()[None], "dt_s": batch["dt_s"]}
        if "motion" in batch:
            window["motion"] = batch["motion"][None]
        output = (float(steering_rad[end]) - float(batch["base_rad"][0])) / model.target.std_rad
        yield Example(drive, [_pad(graphs.read(row, row + 1)) for row in range(span.start, span.stop)], window, output)


def _pad(frame: Arrays) -> Arrays:
    """Return the arrays of a frame in the order of :class:`Spatial`, with a graph's neighbours padded to [N,D]."""
    if "degree" not in frame:
        names = sorted((name for name in frame if "_" in name), key=lambda name: (name.split("_")[1], name))
        return {name: frame[name] for name in ("image", "xyz", "cls", *names) if name in frame and "ptr" not in name}
    degree = frame["degree"].astype(np.int64)
    neighbours = np.zeros((len(degree), max(2, degree.max(initial=0))), np.int64)
    neighbours[np.arange(neighbours.shape[1]) < degree[:, None]] = frame["indices"]
    return {"xyz": frame["xyz"], "cls": frame["cls"], "degree": frame["degree"], "neighbours": neighbours}


def _largest_difference(path: Path, calls: list[tuple[Arrays, Any]]) -> float:
    program = torch.export.load(path).module()
    differences = [
        np.abs(program(*map(torch.from_numpy, arrays.values())).numpy() - expected).max() for arrays, expected in calls
    ]
    return float(np.max(differences))


@contextmanager
def _exporting(where: str) -> Iterator[None]:
    """Raise torch's export errors, which have many types and long advice, as InputError; suppress its warnings."""
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            yield
    except OSError:
        raise
    except Exception as error:
        raise InputError(f"cannot be exported: {str(error).strip().splitlines()[0]}", where) from error
    finally:
        logging.disable(logging.NOTSET)
