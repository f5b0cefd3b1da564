"""Export a trained network with torch.export: two files, verified on real frames, and a manifest for their use."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core import batch
from models.steering.core.steering_net import SteeringNet
from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.base.resume import file_hash
from pipeline.graphs import graph_file
from pipeline.graphs.graph_file import Arrays
from pipeline.train import windows
from pipeline.train.labelled_drive import Timeline
from pipeline.train.predict import Trained

MANIFEST = "export.json"
MAX_DRIVES, WINDOWS_PER_DRIVE = 4, 4
USE = "steering_rad = base_rad + std_rad * recurrent(spatial features of a window, oldest first, ...), left positive"
INPUTS = {
    **batch.INPUTS,
    "features": "float32 [1, window, features]",
    "dt_s": "float32 [1, window], seconds since the previous frame, 0.1 for the first",
    "motion": "float32 [1, window, 4]: measured steering angle in rad, yaw_rate_radps, speed_mps, valid (0 or 1)",
}


class Spatial(nn.Module):
    """The spatial part: the arrays `names` of one frame, see batch.pad → features [1,F]."""

    def __init__(self, net: SteeringNet, names: list[str]) -> None:
        super().__init__()
        # Without the recurrent part, which would become part of the file.
        self.net, self.names = SteeringNet(net.spatial, nn.Identity(), net.equivariant), names  # type: ignore[arg-type]

    def forward(self, *arrays: Tensor) -> Tensor:
        return self.net.encode(batch.from_arrays(dict(zip(self.names, arrays, strict=True))))


class Recurrent(nn.Module):
    """The recurrent part: features [1,T,F], dt_s [1,T], of networks with motion also motion [1,T,4] → output [1]."""

    windows: Tensor

    def __init__(self, net: SteeringNet, window: int) -> None:
        super().__init__()
        self.net = SteeringNet(nn.Identity(), net.temporal, net.equivariant, net.motion)
        self.register_buffer("windows", torch.arange(window)[None])

    def forward(self, features: Tensor, dt_s: Tensor, *motion: Tensor) -> Tensor:
        return self.net.run_windows(features[0], self.windows, dt_s, *(rows[0] for rows in motion))


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
        out: new, empty, or an unchanged earlier export, which is replaced when both files are verified.
        tolerance: largest difference from the network's features and outputs, both about 1 in size.
    Raises:
        InputError: `out` contains other files, the network cannot be exported, or a file differs by more.
    """
    model.check_same_scene()
    target = model.angle_target
    _check_replaceable(out)
    model.net.requires_grad_(False)
    examples = read_examples(model, graphs)
    modules = {
        "spatial": Spatial(model.net, [*examples[0].frames[0]]),
        "recurrent": Recurrent(model.net, model.entry.window),
    }
    calls: dict[str, list[tuple[Arrays, Any]]] = {  # inputs and expected results
        "spatial": [
            call for example in examples for call in zip(example.frames, example.window["features"][0], strict=True)
        ],
        "recurrent": [(example.window, example.output) for example in examples],
    }
    base = "measured angle of the last frame" if model.net.motion and model.entry.base == "motion" else "0"
    with replacing(out) as tmp:
        tmp.mkdir()
        differences = {
            name: _write_program(
                tmp / f"{name}.pt2", module, calls[name], tolerance, f"{name} part of model {model.name}"
            )
            for name, module in modules.items()
        }
        manifest = {
            "model": {
                "name": model.name,
                "seed": model.seed,
                "fold": model.fold,
                "line": model.entry.model_dump(mode="json"),
            },
            "use": USE,
            "base_rad": base,
            "window": model.entry.window,
            "horizon": model.entry.horizon,
            **vars(target),
            "inputs": {
                part: {name: INPUTS[name.rstrip("0123456789")] for name in arrays}
                for part, ((arrays, _), *_) in calls.items()
            },
            "verified": {"windows": len(examples), "drives": [*dict.fromkeys(example.drive for example in examples)]},
            "largest_difference": differences,
            "torch": torch.__version__,
            "sha256": {path.name: file_hash(path) for path in sorted(tmp.iterdir())},
        }
        store.write_json(tmp / MANIFEST, manifest, sort_keys=False)
    return manifest


def _check_replaceable(out: Path) -> None:
    """Raise InputError unless a folder is new, empty, or holds exactly the files of an earlier export."""
    fix = "Choose a new folder: --out"
    if not out.exists() and not out.is_symlink():
        return
    if not out.is_dir() or out.is_symlink():
        raise InputError("expected a folder", out, fix)
    names = {path.name for path in out.iterdir()}
    if not names:
        return
    if MANIFEST not in names:
        raise InputError("the folder is not empty, and is not an earlier export", out, fix)
    hashes = store.read_json(out / MANIFEST, stage="export").get("sha256")
    hashes = hashes if isinstance(hashes, dict) else {}
    foreign = names - {*hashes, MANIFEST} or {
        name for name in names & hashes.keys() if file_hash(out / name) != hashes[name]
    }
    if foreign:
        raise InputError(f"files that no export wrote: {', '.join(sorted(foreign))}", out, fix)


def _write_program(
    path: Path, module: nn.Module, calls: list[tuple[Arrays, Any]], tolerance: float, where: str
) -> float:
    """Export a module to a file, and return its largest difference from expected results.

    Raises InputError if it cannot be exported, or differs by more than `tolerance`.
    """
    with _exporting(where):
        tensors = tuple(torch.from_numpy(array) for array in calls[0][0].values())
        sizes = tuple(dict.fromkeys(range(tensor.ndim), torch.export.Dim.AUTO) for tensor in tensors)
        dynamic = (sizes,) if isinstance(module, Spatial) else None  # windows have a fixed size
        program = torch.export.export(module, tensors, dynamic_shapes=dynamic, strict=False)
        torch.export.save(program, path)
        difference = _largest_difference(path, calls)
    if not difference <= tolerance:  # also for NaN
        problem = f"the exported program differs by {difference:.2g} (tolerance {tolerance:.2g})"
        raise InputError(problem, where, "Intended? Raise --tolerance")
    return difference


def read_examples(model: Trained, graphs: Path) -> list[Example]:
    """Read windows of some drives, test drives first, evenly spread over each. Raises InputError without any."""
    splits = store.read_index(graphs, stage="graphs")
    drives = [drive for split in reversed(SPLITS) for drive in store.drives_in(splits, split)]
    examples: list[Example] = []
    for drive in drives[:MAX_DRIVES]:
        with graph_file.open_graphs(graphs / f"{drive}.h5") as file:
            examples += _read_drive(model, drive, file)
    if not examples:
        raise InputError(f"no window of {model.entry.window} consecutive frames for verification", graphs)
    return examples


def _read_drive(model: Trained, drive: str, graphs: graph_file.Graphs) -> Iterator[Example]:
    steering_rad = model.predict(graphs)
    timeline = Timeline.read(graphs, model.entry.motion, model.target.car, model.entry.base)
    ends = np.flatnonzero(~np.isnan(steering_rad))
    for end in ends[np.linspace(0, len(ends) - 1, min(WINDOWS_PER_DRIVE, len(ends))).round().astype(int)].tolist():
        span = windows.Span(0, end - model.entry.window + 1, end + 1)
        (arrays,) = windows.batches([timeline], [[span]], model.entry.window, {0: graphs})
        with torch.inference_mode():
            window = {"features": model.net.encode(model.net.frames(arrays)).numpy()[None], "dt_s": arrays["dt_s"]}
        if "motion" in arrays:
            window["motion"] = arrays["motion"][None]
        output = (float(steering_rad[end]) - float(arrays["base_rad"][0])) / model.angle_target.std_rad
        yield Example(
            drive, [batch.pad(graphs.read(row, row + 1)) for row in range(span.start, span.stop)], window, output
        )


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
