"""Count processed frames, in worker processes too, and remember the current one for error messages."""

from collections.abc import Callable, Iterable, Iterator

_frame: int | None = None
_report: Callable[[int], object] | None = None


def track(frames: Iterable[int]) -> Iterator[int]:
    """Yield KITTI frame numbers; a frame counts as done when the next one is requested."""
    global _frame
    for frame in frames:
        _frame = int(frame)
        yield frame
        advance(1)
    _frame = None


def advance(frames: int) -> None:
    """Count `frames` more as done."""
    if _report:
        _report(frames)


def take_frame() -> int | None:
    """Return the frame that :func:`track` yielded last, once; None outside of it."""
    global _frame
    frame, _frame = _frame, None
    return frame


def report_to(report: Callable[[int], object] | None) -> None:
    """Have :func:`advance` call `report` in this process; None: do not count."""
    global _report
    _report = report
