"""Trials of mutated bytes: the same ones for a seed, whatever else runs."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.stress.readers import READERS, Reader, fingerprint
from benchmarks.stress.trial import Outcome, outcomes

Tried = tuple[str, Callable[[], Iterator[Outcome]]]


def tries(sound: Path, scratch: Path, trials: int, seed: int) -> Iterator[Tried]:
    """Yield each reader's file, and what does its trials."""
    for reader in READERS:
        if (sound / reader.name).is_file():  # recorded files only where there are some
            yield reader.name, partial(_outcomes, reader, sound, scratch, trials, seed)


def _outcomes(reader: Reader, sound: Path, scratch: Path, trials: int, seed: int) -> Iterator[Outcome]:
    folder = Path(shutil.copytree(sound, scratch / "tried", dirs_exist_ok=True))
    content = (sound / reader.name).read_bytes()
    path = folder / (reader.called or reader.name)
    path.write_bytes(content)
    expected = fingerprint(reader.read(path))

    def work(trial: int) -> bool:
        rng = np.random.default_rng([seed, trial, *reader.name.encode()])
        mutation = reader.mutations[int(rng.integers(len(reader.mutations)))]
        path.write_bytes(mutation(bytearray(content), rng))
        result = reader.read(path)
        if fingerprint(result) == expected:
            return True
        assert reader.check, f"{mutation.__name__} was not noticed"
        reader.check(path, result)
        return False

    yield from outcomes(work, range(trials), path)
    shutil.rmtree(folder)
