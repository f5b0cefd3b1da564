"""A thread or worker processes read the same batches as this process."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pipeline.train import augment, windows
from pipeline.train.reading import Reader, TrainStep
from tests import artefacts


@pytest.fixture
def drives(tmp_path: Path) -> list[windows.LabelledDrive]:
    splits = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
    artefacts.write_dataset(tmp_path, splits, frames=30, points=40)
    return windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(splits), 4)


def planned(seed: int) -> list[TrainStep]:
    rng = np.random.default_rng(seed)
    steps = []
    for number in range(6):
        runs = tuple(windows.Span(drive, start, start + 9) for drive, start in ((number % 2, number), (1, 2 * number)))
        factor = rng.uniform(0.8, 1.2, 2).astype(np.float32)
        steps.append(TrainStep(runs, factor))
    return steps


def expected_batch(drives: Sequence[windows.LabelledDrive], step: TrainStep) -> dict[str, np.ndarray]:
    (batch,) = windows.batches(drives, [step.runs], 4)
    return augment.rescale(batch, np.repeat(step.factor, 9))


def same(read: dict[str, Any], expected: dict[str, np.ndarray]) -> None:
    assert read.keys() == expected.keys()
    for name, tensor in read.items():
        assert isinstance(tensor, torch.Tensor)
        np.testing.assert_array_equal(tensor.numpy(), expected[name], strict=True)


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_batches_equal_the_reference(drives: list[windows.LabelledDrive], workers: int) -> None:
    with Reader(drives, 4, torch.device("cpu"), workers) as reader:
        for epoch in range(2):  # with the same processes
            steps = planned(epoch)
            for step, batch in zip(steps, reader.batches(steps), strict=True):
                same(batch, expected_batch(drives, step))
