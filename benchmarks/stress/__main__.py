"""Try every reader on damaged files, and say what came of it as a Markdown table. Exit status 1 if one failed.

python -m benchmarks.stress --kitti ../shared/kitti --trials 500
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.stress import hostile, hostile_hdf5, mutated, originals
from benchmarks.stress.trial import Outcome
from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.report.tables import markdown

COLUMNS = ("file", "trials", "refused", "read as written", "read otherwise, but consistent", "failed", "seconds")


def main(
    kitti: Annotated[Path | None, typer.Option(help="a KITTI raw folder, whose files are mutated too")] = None,
    trials: Annotated[int, typer.Option(help="mutations of each file")] = 500,
    seed: Annotated[int, typer.Option(help="of all mutations")] = 0,
    only: Annotated[str, typer.Option(help="part of the file's name")] = "",
) -> None:
    """Damage files in every way, read them as the stages do, and count what happens."""
    if kitti and not kitti.is_dir():
        raise InputError(f"{kitti} is missing: name a folder of KITTI raw, or leave --kitti out")
    with tempfile.TemporaryDirectory() as scratch:
        rows, failures = run(Path(scratch), kitti, trials, seed, only)
    print("\n".join(markdown.table(COLUMNS, rows)))
    for name, outcome in failures[:40]:
        print(f"\n{name}, trial {outcome.trial}: {outcome.kind}\n{outcome.detail}")
    if failures:
        sys.exit(1)


def run(
    scratch: Path, kitti: Path | None, trials: int, seed: int, only: str = ""
) -> tuple[list[list[str]], list[tuple[str, Outcome]]]:
    """Return the table's rows, and the outcomes that must not be."""
    sound = scratch / "sound"
    sound.mkdir()
    originals.write_all(sound, kitti)
    rows, failures, total = [], [], Counter[str]()
    for name, tried in [
        *mutated.tries(sound, scratch, trials, seed),
        *hostile_hdf5.tries(sound, scratch, trials, seed),
        *hostile.tries(sound, scratch),
    ]:
        if only not in name:
            continue
        start = time.perf_counter()
        outcomes = list(tried())
        counts = Counter(outcome.kind if outcome.sound else "failed" for outcome in outcomes)
        failures += [(name, outcome) for outcome in outcomes if not outcome.sound]
        seconds = time.perf_counter() - start
        rows.append(_row(name, counts, seconds))
        total += counts
        print(f"{name}: {dict(counts)}, {seconds:.0f} s", file=sys.stderr)
    return [*rows, _row("all", total, sum(float(row[-1]) for row in rows))], failures


def _row(name: str, counts: Counter[str], seconds: float) -> list[str]:
    kinds = [str(counts[kind]) for kind in ("refused", "same", "consistent", "failed")]
    return [name, str(counts.total()), *kinds, f"{seconds:.0f}"]


if __name__ == "__main__":
    console.run(main)
