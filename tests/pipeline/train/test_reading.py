"""A thread or worker processes read the same batches as this process."""

import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import fit, windows
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.prefetch import prefetch, side_by_side
from pipeline.train.reading import Reader, Step, rescale
from pipeline.train.scale import Scale
from tests import artefacts, small_model


@pytest.fixture
def drives(tmp_path: Path) -> list[LabelledDrive]:
    splits = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
    artefacts.write_dataset(tmp_path, splits, frames=30, points=40)
    return read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(splits), 4)


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_batches_are_the_same_with_each_reader(drives: list[LabelledDrive], workers: int) -> None:
    groups = [(windows.Span(n % 2, n, n + 9), windows.Span(1, 2 * n, 2 * n + 9)) for n in range(6)]
    factors = np.random.default_rng(0).uniform(0.8, 1.2, (6, 2)).astype(np.float32)
    steps = [Step(group, factor) for group, factor in zip(groups, factors, strict=True)]
    with Reader(drives, 4, dict) as alone, Reader(drives, 4, dict, workers) as reader:
        for _ in range(2):  # with the same processes
            for step, batch in zip(steps, reader.batches(steps), strict=True):
                arrays = {name: tensor.numpy() for name, tensor in alone[Step(step.spans)].items()}
                expected = rescale(arrays, np.repeat(step.factor, 9))
                assert batch.keys() == expected.keys()
                for name, tensor in batch.items():
                    np.testing.assert_array_equal(tensor.numpy(), expected[name], strict=True)


def test_hidden_motion_is_not_measured_and_has_no_base(drives: list[LabelledDrive], tmp_path: Path) -> None:
    names = [drive.name for drive in drives]
    for name in names:
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", np.full(30, 0.2))
    folders = tmp_path / "graphs/semantic", tmp_path / "labels"
    moving = read_drives(*folders, names, 4, horizon=5, motion="visual")
    runs = windows.Span(0, 2, 11), windows.Span(1, 4, 13)
    with Reader(moving, 4, dict) as reader:
        shown, half = reader[Step(runs)], reader[Step(runs, hide_motion=np.array([False, True]))]
    assert (shown["base"] != 0).all()
    assert (shown["motion"][:, 3] == 1).all()
    for name in ("motion", "base"):
        first = len(shown[name]) // 2
        assert torch.equal(half[name][:first], shown[name][:first])
        assert not half[name][first:].any()
    assert torch.equal(half["target"], shown["target"])


@pytest.mark.parametrize(("ahead", "motion", "hides"), [(5, True, True), (0, True, False), (5, False, False)])
def test_motion_is_hidden_from_half_of_the_runs_if_the_target_lies_ahead(
    drives: list[LabelledDrive], tmp_path: Path, ahead: int, motion: bool, hides: bool
) -> None:
    names = [drive.name for drive in drives]
    drives = read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", names, 4, horizon=ahead)
    line = {"input": "semantic", "spatial": "blind", "temporal": "lstm", "window": 4}
    entry = Entry.model_validate(line | {"motion": "visual" if motion else "none"})
    settings = Train.model_validate(yaml.safe_load(small_model.PARAMS.read_text())["train"] | {"span_windows": 1})
    fitting = fit.Fit(entry.build("graph"), entry, settings, 0, Scale.from_drives(drives))
    hidden = [step.hide_motion for step in fitting._plan(drives, epoch=1) if step.hide_motion is not None]
    assert bool(hidden) == hides
    assert not hides or 0.3 < np.concatenate(hidden).mean() < 0.7


class Source:
    """Count up to `stop`, then raise `error`; record progress, threads and closing."""

    def __init__(self, stop: int, error: Exception | None = None) -> None:
        self.stop, self.error = stop, error
        self.count, self.threads, self.closed = 0, set[str](), False

    def items(self) -> Generator[int]:
        try:
            for number in range(self.stop):
                self.count += 1
                self.threads.add(threading.current_thread().name)
                yield number
            if self.error:
                raise self.error
        finally:
            self.closed = True


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    yield
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize("count", [0, 1, 4, 30])
def test_items_come_in_order_from_one_other_thread(count: int) -> None:
    source = Source(count)
    assert list(prefetch(source.items(), ahead=3)) == list(range(count))
    assert source.closed
    assert threading.current_thread().name not in source.threads
    assert len(source.threads) <= 1


def test_results_come_in_the_order_of_items_whichever_is_ready_first() -> None:
    later = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert later.wait(10)
        elif number == 2:
            later.set()
        return number**2

    assert list(side_by_side(work, Source(9).items(), threads=3, ahead=4)) == [number**2 for number in range(9)]


@pytest.mark.parametrize("parallel", [False, True])
def test_the_number_of_items_ahead_is_bounded(parallel: bool) -> None:
    source = Source(100)
    ready = side_by_side(abs, source.items(), threads=3, ahead=4) if parallel else prefetch(source.items(), ahead=4)
    for number in range(5):
        assert next(ready) == number
        time.sleep(0.01)
        assert number + 1 < source.count <= number + 1 + 4
    ready.close()
    assert source.closed


def test_an_error_of_the_items_is_raised_after_them() -> None:
    source, received = Source(4, ValueError("frame 4 is damaged")), []
    with pytest.raises(ValueError, match="frame 4 is damaged"):
        received.extend(prefetch(source.items()))
    assert source.closed
