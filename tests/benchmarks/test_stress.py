"""Readers on damaged files: the short version of python -m benchmarks.stress, and what it counts as what."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.stress import __main__ as stress
from benchmarks.stress import hostile_hdf5, mutations, trial
from pipeline.base.errors import InputError

TRIALS = 12  # of each file; make stress does 450


@pytest.mark.slow
def test_no_reader_fails_on_a_damaged_file(tmp_path: Path) -> None:
    """Neither a traceback, a hang, 2 GB nor wrong numbers: refused by a line that names the file, or read right."""
    rows, failures = stress.run(tmp_path, None, TRIALS, seed=1)
    assert not failures, "\n".join(f"{name}, trial {one.trial}: {one.kind}\n{one.detail}" for name, one in failures)
    *files, total = rows
    assert int(total[1]) > 500
    refused = {row[0]: int(row[2]) for row in files}
    assert min(refused[name] for name in ("image.png", "knn.h5", "best.pt", "params.yaml")) > TRIALS // 3
    assert all(int(row[1]) == int(row[2]) for row in files if row[0].endswith("made by hand"))


def test_what_must_not_be_is_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"

    def work(number: int) -> bool:
        match number:
            case 2:
                raise InputError(f"{path} is damaged")
            case 3:
                raise InputError("something is damaged")
            case 4:
                raise KeyError("x")
            case 5:
                raise AssertionError
            case 6:
                np.zeros(trial.MOST_BYTES + (1 << 28), np.uint8)
            case 7:
                os._exit(3)
        return number == 0

    outcomes = list(trial.outcomes(work, range(9), path))
    kinds = ["same", "consistent", "refused", "nameless", "traceback", "wrong", "memory", "crash", "consistent"]
    assert [(outcome.trial, outcome.kind) for outcome in outcomes] == list(enumerate(kinds))
    assert [outcome.sound for outcome in outcomes] == [kind in trial.SOUND for kind in kinds]


def test_a_hang_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "WAIT_S", 0.5)
    outcomes = trial.outcomes(lambda number: bool(time.sleep(60 * (number == 0))) or True, range(2), tmp_path)
    assert [outcome.kind for outcome in outcomes] == ["hang", "same"]


def test_mutations_are_those_of_the_seed() -> None:
    content = bytes(range(32, 127)) * 20
    for mutation in {*mutations.BINARY, *mutations.TEXT}:
        first, again, other = (
            [mutation(bytearray(content), np.random.default_rng([seed, n])) for n in range(9)] for seed in (0, 0, 1)
        )
        assert first == again != other
        assert sum(mutated != content for mutated in first) >= 8


def test_every_stage_has_hostile_files() -> None:
    assert hostile_hdf5.OF_KIND.keys() <= hostile_hdf5.HDF5.keys()
    assert {"ingest", "labels", "perception", "motion", "clouds"} < hostile_hdf5.HDF5.keys()
