"""Running over blocks of frames: the same bytes for any size and any workers; what ends a run keeps its blocks."""

import os
import re
import subprocess
import sys
import traceback
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base import pool, progress
from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.pool import run_over_frames
from pipeline.base.store import DriveReader, DriveWriter
from tests.kitti_drive import contents

NUMBERS = {"a": range(10, 21), "b": range(3), "empty": range(0)}  # 11, 3 and no frames


def work(drive: str, rows: range, file: DriveWriter, log: Path, trouble: dict[str, str]) -> dict[str, Any]:
    """Note the call in `log`, write some frames, run into the trouble that one of them has."""
    with log.open("a") as lines:
        lines.write(f"{drive}{rows.start}-{rows.stop}\n")
    file.put("frame", np.array(NUMBERS[drive], np.int32)[rows.start : rows.stop])
    file.append("xyz", np.empty((0, 3), np.float32), "m")
    for row in progress.counted(rows):
        match trouble.get(f"{drive}{row}"):
            case "die":
                os._exit(9)
            case "fail":
                raise DamagedFile("0.png is cut short")
            case "bug":
                raise ZeroDivisionError
        file.append("xyz", np.random.default_rng(row).normal(size=(3000 * (row % 3), 3)).astype(np.float32))
    file.put_pointers("ptr", [3000 * (row % 3) for row in rows], "row")
    if trouble.get(drive) == "late":
        raise InputError("the drive is too long")
    return {"frames": len(rows), "points": 3000 * sum(row % 3 for row in rows)}


def run(tmp_path: Path, trouble: dict[str, str] | None = None, **changes: Any) -> dict[str, Any]:
    (tmp_path / "log").unlink(missing_ok=True)
    options: dict[str, Any] = {"settings": {"k": 6}, "inputs": lambda drive: ["fingerprint"], "workers": 1} | changes
    return run_over_frames(
        partial(work, log=tmp_path / "log", trouble=trouble or {}),
        list(NUMBERS),
        stage="labels",
        params={"k": 6},
        frames=NUMBERS.__getitem__,
        out=tmp_path / "data/labels",
        **options,
    )


def calls(tmp_path: Path) -> list[str]:
    return sorted((tmp_path / "log").read_text().split())


def finished(tmp_path: Path) -> dict[str, bytes]:
    return contents(tmp_path / "data/labels")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of drives that are a block each."""
    folder = tmp_path_factory.mktemp("whole")
    run(folder)
    assert calls(folder) == ["a0-11", "b0-3", "empty0-0"]
    return finished(folder)


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 5])
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_neither_workers_nor_blocks_change_a_byte(
    tmp_path: Path, whole: dict[str, bytes], workers: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "BLOCK_FRAMES", size)
    summaries = run(tmp_path, workers=workers)
    assert list(summaries) == [*NUMBERS]
    assert summaries["a"] == {"frames": 11, "points": 3000 * sum(row % 3 for row in range(11))}
    assert len(calls(tmp_path)) == -(-11 // size) + -(-3 // size) + 1
    assert finished(tmp_path) == whole
    assert not list((tmp_path / "data/.resume").iterdir()), "on success, nothing waits"


def test_a_file_holds_its_frames_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 4)
    run(tmp_path)
    with DriveReader(tmp_path / "data/labels/a.h5", stage="labels") as file:
        assert file.frame.tolist() == [*NUMBERS["a"]]
        rows = [np.random.default_rng(row).normal(size=(3000 * (row % 3), 3)) for row in range(11)]
        np.testing.assert_array_equal(file["xyz"], np.concatenate(rows).astype(np.float32))
        assert file.drive == "a"


def test_frames_that_belong_together_are_in_one_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 4)
    run(tmp_path, together=3)
    assert calls(tmp_path) == ["a0-6", "a6-11", "b0-3", "empty0-0"]


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_frame_that_fails_is_named_and_finished_blocks_are_kept(
    tmp_path: Path, whole: dict[str, bytes], workers: int, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 2)
    with pytest.raises(DamagedFile, match=r"^a, frame 17: 0\.png is cut short$"):
        run(tmp_path, {"a7": "fail"}, workers=workers)
    assert finished(tmp_path) == {}
    done = {call for call in calls(tmp_path) if call != "a6-8"}
    assert {"a0-2", "a2-4", "a4-6"} <= done
    capsys.readouterr()
    run(tmp_path, workers=workers)
    assert not done & set(calls(tmp_path))
    assert finished(tmp_path) == whole
    assert re.search(r"^\d+ frames of other drives kept from the run before$", capsys.readouterr().out, re.M)


def test_a_bug_names_its_frame_in_the_traceback(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError) as error:
        run(tmp_path, {"b2": "bug"})
    assert "b, frame 2\n" in "".join(traceback.format_exception(error.value))


def test_what_is_not_about_a_frame_names_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^the drive is too long$"):
        run(tmp_path, {"a": "late"})


@pytest.mark.slow
def test_a_dead_worker_names_the_frames_and_keeps_the_other_blocks(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The pool breaks for all jobs at once: which of them it tells of first is chance; drive `empty` has no frames.
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 2)
    with pytest.raises(
        InputError, match=r"a worker process died .* at or near ([ab], frames \d+ to \d+|empty): .*kept$"
    ):
        run(tmp_path, {"a9": "die"}, workers=2)
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 2)
    run(tmp_path, workers=2)
    assert "a0-2" not in calls(tmp_path)
    assert finished(tmp_path) == whole


PROGRAM = """
if __name__ == "__main__":
    import sys
    from pathlib import Path
    from pipeline.base import pool
    from tests.pipeline.base.test_pool_frames import run
    pool.BLOCK_FRAMES = 2
    run(Path(sys.argv[1]), {"a7": "die"})
"""


@pytest.mark.slow
def test_a_killed_process_keeps_the_blocks_before(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    root = str(Path(__file__).resolve().parents[3])
    process = subprocess.run([sys.executable, tmp_path / "program.py", tmp_path], env=os.environ | {"PYTHONPATH": root})
    assert process.returncode == 9
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 2)
    run(tmp_path)
    assert calls(tmp_path) == ["a10-11", "a6-8", "a8-10", "b0-2", "b2-3", "empty0-0"]
    assert finished(tmp_path) == whole


def test_blocks_of_another_size_or_with_other_settings_are_not_taken(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 2)
    with pytest.raises(InputError):
        run(tmp_path, {"a7": "fail"})
    with pytest.raises(InputError):
        run(tmp_path, {"a7": "fail"}, settings={"k": 7})
    assert "a0-2" in calls(tmp_path)
    monkeypatch.setattr(pool, "BLOCK_FRAMES", 3)
    run(tmp_path)
    assert calls(tmp_path) == ["a0-3", "a3-6", "a6-9", "a9-11", "b0-3", "empty0-0"]
    assert finished(tmp_path) == whole


def test_on_a_terminal_the_bar_counts_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    run(tmp_path)
    assert "14/14" in capsys.readouterr().err.split("\r")[-1]
