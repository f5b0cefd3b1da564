"""A trained network for programs without Python: its two parts as files, verified on real frames, and how to use them.

features = spatial(frame)                    once per frame; the last `window` ones are kept
answer = recurrent(features, dt_s)           of each window
steering_rad = base_rad + std_rad * answer
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.store import write_json
from pipeline.live.export import cases as real
from pipeline.live.export import parts, programs
from pipeline.live.export.cases import Case
from pipeline.live.export.parts import Part
from pipeline.live.export.programs import Program
from pipeline.train.predict import Trained

SAYS = "export.json"
FORMATS = ("pt2", "onnx")


def export(model: Trained, graphs: Path, out: Path, tolerance: float) -> dict[str, Any]:
    """Write a model's two parts to the folder `out`, which appears when all that is in it is verified.

    Args:
        model: on the CPU.
        graphs: the folder of the graph variant that it was trained on.
        out: new, empty, or an earlier export, which it takes the place of.
        tolerance: the largest difference from the network's own features and answers, both about 1 in size.
    Returns:
        The content of its export.json.
    Raises:
        InputError: `out` holds something else, a part cannot be exported, or differs by more.
    """
    _check_out(out)
    model.net.requires_grad_(False)
    cases = real.read(model, graphs)
    features = int(model.line["features"])
    both = {
        "spatial": parts.spatial(model.net, features, model.contents, cases[0].frames[0]),
        "recurrent": parts.recurrent(model.net, model.window, features),
    }
    examples = {
        "spatial": cases[0].frames[0],
        "recurrent": {**cases[0].inputs, "features": cases[0].features[None]},
    }
    without: dict[str, str] = {}
    with replacing(out) as tmp:
        tmp.mkdir()
        for name, part in both.items():
            with error_context(where=f"model {model.name}, spatial: {model.line['spatial']}"):
                program = programs.exported(part, examples[name])
            programs.write_pt2(program, tmp / f"{name}.pt2")
            why = programs.no_onnx() or programs.write_onnx(program, part, tmp / f"{name}.onnx")
            if why:
                without[f"{name}.onnx"] = why
        differences = _verify(tmp, both, cases, model.target.std_rad)
        for file, difference in differences.items():
            if not difference <= tolerance:  # NaN is no number below it
                raise InputError(
                    f"{file} of model {model.name} differs from the network by {difference:.2g}, more than the "
                    f"tolerance of {tolerance:.2g}: nothing is written. On purpose? Say --tolerance"
                )
        content = _content(model, both) | {
            "without": without,
            "verified": {
                "largest_difference": differences,
                "tolerance": tolerance,
                "windows": len(cases),
                "frames": sum(len(case.frames) for case in cases),
                "drives": list(dict.fromkeys(case.drive for case in cases)),
            },
        }
        write_json(tmp / SAYS, content, sort_keys=False)
    return content


def _check_out(out: Path) -> None:
    if out.exists() and not (out / SAYS).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is there, and no earlier export: name a new folder by --out")


def _verify(folder: Path, both: dict[str, Part], cases: Sequence[Case], std_rad: float) -> dict[str, float]:
    """Return how far each file is from the network at most, and all files of a format one after the other."""
    differences: dict[str, float] = {}
    reading = {"pt2": programs.read_pt2, "onnx": programs.read_onnx}
    for kind in FORMATS:
        paths = {name: folder / f"{name}.{kind}" for name in both}
        read = {name: reading[kind](path, both[name]) for name, path in paths.items() if path.is_file()}
        if "spatial" in read:
            seen = [_features(read["spatial"], case) for case in cases]
            pairs = zip(seen, cases, strict=True)
            differences[paths["spatial"].name] = max(float(np.abs(own - case.features).max()) for own, case in pairs)
        if "recurrent" in read:
            answers = [_answer(read["recurrent"], case, case.features) for case in cases]
            differences[paths["recurrent"].name] = _off(answers, cases, std_rad)
        if len(read) == len(both):
            answers = [_answer(read["recurrent"], case, own) for case, own in zip(cases, seen, strict=True)]
            differences[f"spatial and recurrent .{kind}"] = _off(answers, cases, std_rad)
    return differences


def _features(spatial: Program, case: Case) -> np.ndarray:
    return np.concatenate([spatial(frame) for frame in case.frames])


def _answer(recurrent: Program, case: Case, features: np.ndarray) -> float:
    return float(recurrent({**case.inputs, "features": features[None]})[0])


def _off(answers: Sequence[float], cases: Sequence[Case], std_rad: float) -> float:
    pairs = zip(answers, cases, strict=True)
    return max(abs(answer - case.answer(std_rad)) for answer, case in pairs)


def _content(model: Trained, both: dict[str, Part]) -> dict[str, Any]:
    """Return what a user of the files has to know."""
    base = "0"
    if model.net.motion:
        base = (
            "measured_rad of the last frame: atan(wheelbase_m yaw_rate / speed), held where that is slow or not valid"
        )
    return {
        "model": model.name,
        "seed": model.seed,
        "fold": model.fold,
        "line": model.line,
        "use": "features = spatial(frame), answer = recurrent(features of the window), "
        "steering_rad = base_rad + std_rad * answer, left +",
        "window": model.window,
        "horizon": model.horizon,
        "base_rad": base,
        "std_rad": model.target.std_rad,
        "wheelbase_m": model.target.wheelbase_m,
        "min_speed_mps": model.target.min_speed_mps,
        "torch": torch.__version__,
        "parts": {
            name: {"inputs": [asdict(each) for each in part.inputs], "output": asdict(part.output)}
            for name, part in both.items()
        },
    }
