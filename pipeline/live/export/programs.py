"""Writing a part as a program, and running what was written: torch.export's .pt2 and ONNX's .onnx."""

import inspect
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pipeline.base.errors import InputError
from pipeline.live.export.parts import Arrays, Part

Program = Callable[[Arrays], np.ndarray]
"""Arrays by name → what the part gives."""
ONNX = ("onnx", "onnxscript", "onnxruntime")  # the extra of pyproject.toml


def exported(part: Part, example: Arrays) -> torch.export.ExportedProgram:
    """Return a part as torch.export has it, traced with `example`. Raises InputError if it cannot be traced."""
    with _quiet(), torch.no_grad():
        try:
            return torch.export.export(part.module, part.tensors(example), dynamic_shapes=_shapes(part), strict=False)
        except Exception as error:  # whatever a network's code does that torch cannot follow; it has no common type
            raise InputError(f"the {part.name} part cannot be exported: {_first_line(error)}") from error


def write_pt2(program: torch.export.ExportedProgram, path: Path) -> None:
    """Write a program for torch::export::load and torch.export.load."""
    with _quiet():
        torch.export.save(program, path)


def read_pt2(path: Path, part: Part) -> Program:
    """Return a written program to run."""
    with _quiet():
        module = torch.export.load(path).module()

    def run(arrays: Arrays) -> np.ndarray:
        with torch.inference_mode():
            output: np.ndarray = module(*part.tensors(arrays)).numpy()
        return output

    return run


def no_onnx() -> str | None:
    """Return why there can be no ONNX here, or None: a file that nobody can run is not verified, so not written."""
    missing = [name for name in ONNX if find_spec(name) is None]
    return f"{', '.join(missing)} not installed: pip install '.[onnx]'" if missing else None


def write_onnx(program: torch.export.ExportedProgram, part: Part, path: Path) -> str | None:
    """Write a program as one ONNX file; return why there is none, as an operator has no counterpart there, or None."""
    with _quiet():
        try:
            names, output = [each.name for each in part.inputs], [part.output.name]
            made = torch.onnx.export(program, input_names=names, output_names=output, dynamo=True, verbose=False)
            assert made is not None, "it returns a program where it is told of no file"
            made.save(path, external_data=False)
        except Exception as error:  # the exporter's errors have no common type
            path.unlink(missing_ok=True)
            return _first_line(error)
    return None


def read_onnx(path: Path, part: Part) -> Program:
    """Return a written program to run by onnxruntime, on the CPU."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    def run(arrays: Arrays) -> np.ndarray:
        (output,) = session.run(None, {each.name: arrays[each.name] for each in part.inputs})
        return np.asarray(output)

    return run


def _shapes(part: Part) -> tuple[Any, ...]:
    """Return which sizes may change, as torch.export asks for it: those of *args stand together."""
    shapes, code = part.dynamic_shapes(), part.module.forward.__code__
    named = code.co_argcount - 1
    return (*shapes[:named], shapes[named:]) if code.co_flags & inspect.CO_VARARGS else shapes


def _first_line(error: BaseException) -> str:
    """Return what an error says first, or what the one says that it was raised from: exporters explain at length."""
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep to themselves what torch's exporters warn of: their own deprecations, packages that they do not need."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
