"""Values in values, as JSON and checkpoints hold them: mappings, lists, numbers, text, tensors."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.inspect.compare.difference import Difference, Tally

_MOST = 60  # characters of a value that are quoted
_NONE = object()


def of_values(a: Any, b: Any, file: str, tolerance: float, where: str = "") -> Iterator[Difference]:
    """Yield where two values differ, `where` being the dotted key at which they stand."""
    a, b = _array(a), _array(b)
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            inner = f"{where}.{key}" if where else str(key)
            yield from of_values(a.get(key, _NONE), b.get(key, _NONE), file, tolerance, inner)
    elif _is_list(a) and _is_list(b):
        for number in range(max(len(a), len(b))):
            x, y = (of[number] if number < len(of) else _NONE for of in (a, b))
            yield from of_values(x, y, file, tolerance, f"{where}[{number}]")
    elif isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        yield from _of_arrays(a, b, file, tolerance, where)
    elif _is_number(a) and _is_number(b):
        found = Tally(tolerance)
        found.add(np.array([a]), np.array([b]))
        if found.count:
            yield Difference(file, where, f"{a} and {b}", largest=found.largest)
    elif a is _NONE or b is _NONE:
        yield Difference(file, where, f"only in {'B' if a is _NONE else 'A'}")
    elif type(a) is not type(b) or a != b:
        yield Difference(file, where, f"{_short(a)} and {_short(b)}")


def _of_arrays(a: np.ndarray, b: np.ndarray, file: str, tolerance: float, where: str) -> Iterator[Difference]:
    if a.shape != b.shape:
        yield Difference(file, where, f"shape {a.shape} and {b.shape}")
        return
    found = Tally(tolerance)
    found.add(a, b)
    difference = found.difference(file, where, "" if a.dtype == b.dtype else f"dtype {a.dtype} and {b.dtype}")
    if difference:
        yield difference


def _array(value: Any) -> Any:
    """Return a tensor as an array: torch is not imported for a comparison of JSON."""
    if hasattr(value, "detach"):
        value = value.detach().cpu()
        return (value.float() if str(value.dtype) == "torch.bfloat16" else value).numpy()
    return value.item() if isinstance(value, np.generic) else value


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    said = repr(value)
    return said if len(said) <= _MOST else f"{said[:_MOST]}…"
