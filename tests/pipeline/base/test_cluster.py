"""A Dask cluster of two workers on this machine: the bytes of one process, whatever becomes of a worker."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import distributed
import numpy as np
import pytest

from pipeline.base import cluster, progress, store
from pipeline.base.blocks import BlockWriter
from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.pool import run_over_frames, run_side_by_side
from tests import artefacts, small_model, street
from tests.kitti_drive import contents

ROOT = Path(__file__).resolve().parents[3]
NUMBERS = {"a": range(10, 21), "b": range(3), "empty": range(0)}  # 11, 3 and no frames
Trouble = dict[str, str]


def work(drive: str, rows: range, file: BlockWriter, folder: Path, trouble: Trouble) -> dict[str, Any]:
    """Write some frames, each with what all before it in the block and the chain add up to."""
    with (folder / "log").open("a") as lines:
        lines.write(f"{drive}{rows.start} {os.getpid()}\n")
    file.put("frame", np.array(NUMBERS[drive], np.int32)[rows.start : rows.stop])
    file.append("xyz", np.empty((0, 3), np.float32), "m")
    total = int(file.before or b"0")
    for row in progress.counted(rows):
        total += row
        match trouble.get(f"{drive}{row}"):
            case "die":
                os._exit(9)
            case "fail":
                raise DamagedFile("0.png is cut short")
            case "once" if not (folder / "here").exists():
                (folder / "here").write_text(str(os.getpid()))
                time.sleep(600)  # until somebody kills it
        file.append("xyz", np.random.default_rng(total).normal(size=(3000 * (row % 3), 3)).astype(np.float32))
    file.after = str(total).encode()
    return {"frames": len(rows)}


def run(folder: Path, trouble: Trouble | None = None, **changes: Any) -> dict[str, bytes]:
    folder.mkdir(exist_ok=True)
    (folder / "log").unlink(missing_ok=True)
    run_over_frames(
        partial(work, folder=folder, trouble=trouble or {}), list(NUMBERS), stage="labels", params={"k": 6},
        frames=NUMBERS.__getitem__, out=folder / "data/labels", inputs=lambda drive: ["fingerprint"], settings={},
        block_frames=2, workers=1, **changes,
    )  # fmt: skip
    assert not list((folder / "data/.resume").iterdir()), "on success, nothing waits"
    return contents(folder / "data/labels")


def log(folder: Path) -> list[tuple[str, int]]:
    """Return which blocks were begun, and by which process."""
    lines = (folder / "log").read_text().splitlines()
    return sorted((line.split()[0], int(line.split()[1])) for line in lines)


class Started(NamedTuple):
    address: str
    scheduler: subprocess.Popen[bytes]


@contextlib.contextmanager
def started(folder: Path, workers: int) -> Iterator[Started]:
    """A scheduler and its workers, as the command ``dask`` starts them."""
    known, common = folder / "scheduler.json", ["--no-dashboard", "--host", "127.0.0.1"]
    commands = [
        ["dask_scheduler", "--port=0", f"--scheduler-file={known}", *common],
        ["dask_worker", f"--scheduler-file={known}", "--nthreads=1", f"--nworkers={workers}",
         f"--local-directory={folder}", *common],
    ]  # fmt: skip
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    with (folder / "output").open("wb") as output:
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{name}", *options],
                env=environment, cwd=folder, stdout=output, stderr=output,
            )
            for name, *options in commands
        ]  # fmt: skip
        try:
            wait_for(known.exists)
            with distributed.Client(scheduler_file=str(known), set_as_default=False) as client:
                client.wait_for_workers(workers, timeout=120)
                address = client.scheduler.address
            yield Started(address, processes[0])
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait()


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, dict[str, bytes]]:
    """The files that one process makes, of blocks that know nothing of each other, and chained."""
    return {chained: run(tmp_path_factory.mktemp("alone"), chained=chained) for chained in (False, True)}


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with started(tmp_path_factory.mktemp("cluster"), 2) as dask:
        yield dask.address


@pytest.fixture
def address(two_workers: str, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv(cluster.VARIABLE, two_workers)
    return two_workers


@pytest.mark.slow
@pytest.mark.usefixtures("address")
@pytest.mark.parametrize("chained", [False, True])
def test_the_bytes_are_those_of_one_process(tmp_path: Path, alone: dict[bool, Any], chained: bool) -> None:
    assert run(tmp_path, chained=chained) == alone[chained]
    assert alone[True] != alone[False]
    begun = log(tmp_path)
    assert len(begun) == 6 + 2 + 1
    assert os.getpid() not in {process for _, process in begun}


@pytest.mark.slow
@pytest.mark.usefixtures("address")
@pytest.mark.parametrize("chained", [False, True])
def test_a_worker_killed_midway_costs_a_block(tmp_path: Path, alone: dict[bool, Any], chained: bool) -> None:
    def kill() -> None:
        wait_for(lambda: (tmp_path / "here").exists() and (tmp_path / "here").read_text() != "")
        os.kill(int((tmp_path / "here").read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    made = run(tmp_path, {"a5": "once"}, chained=chained)
    killer.join()
    assert made == alone[chained]
    blocks = [block for block, _ in log(tmp_path)]
    assert blocks.count("a4") == 2
    # What it had made just before may not have been told yet, and is made again.
    assert len(blocks) in (6 + 2 + 1 + 1, 6 + 2 + 1 + 2)


@pytest.mark.slow
@pytest.mark.usefixtures("address")
def test_an_error_of_a_worker_is_told_as_of_any_other(tmp_path: Path, alone: dict[bool, Any]) -> None:
    with pytest.raises(DamagedFile, match=r"^a, frame 17: 0\.png is cut short$"):
        run(tmp_path, {"a7": "fail"}, chained=True)
    assert contents(tmp_path / "data/labels") == {}
    assert run(tmp_path, chained=True) == alone[True]
    assert not {"a0", "a2", "a4"} & {block for block, _ in log(tmp_path)}, "finished blocks are kept"


@pytest.mark.slow
def test_a_block_that_kills_every_worker_is_named(tmp_path: Path, address: str, alone: dict[bool, Any]) -> None:
    with pytest.raises(InputError, match=r"^\d workers died .* at or near a, frames 18 to 19, the last .*is kept$"):
        run(tmp_path, {"a9": "die"})
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=120)
    assert run(tmp_path) == alone[False]


@pytest.mark.slow
@pytest.mark.usefixtures("address")
def test_on_a_terminal_the_bar_counts_the_workers_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    run(tmp_path)
    assert "14/14" in capsys.readouterr().err.split("\r")[-1]


def note(job: int, folder: Path) -> None:
    print(f"job {job} of {os.environ.get('OMP_NUM_THREADS')} thread", flush=True)
    (folder / f"{job}").touch()


@pytest.mark.slow
@pytest.mark.usefixtures("address")
def test_side_by_side_what_workers_print_is_printed_here(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_side_by_side(partial(note, folder=tmp_path), range(3), module="stages.labels", mark=ROOT / "pyproject.toml")
    assert sorted(capsys.readouterr().out.splitlines()) == [f"job {job} of 1 thread" for job in range(3)]
    assert {path.name for path in tmp_path.iterdir()} == {"0", "1", "2"}


@pytest.mark.slow
def test_a_stage_as_dvc_starts_it(tmp_path: Path, address: str) -> None:
    """With python -m, its functions are __main__'s; the paths are relative to where it was started."""
    drive = "2026_01_01_drive_0001"
    street.write_drive(tmp_path / "data/ingest", drive, 4, lidar=True)
    street.write_perception(tmp_path / "data/perception", tmp_path / "data/ingest", drive)
    for folder in ("ingest", "perception"):
        store.write_index(tmp_path / "data" / folder, {drive: "train"})
    files = []
    for scheduler in ("", address):
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        command = [sys.executable, "-m", "stages.clouds", f"--params={ROOT / 'params.yaml'}"]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment | {cluster.VARIABLE: scheduler}, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")
        files.append(contents(tmp_path / "data/clouds"))
    assert files[0] == files[1]


@pytest.mark.slow
def test_seeds_are_trained_as_here(tmp_path: Path, two_workers: str, monkeypatch: pytest.MonkeyPatch) -> None:
    artefacts.write_dataset(tmp_path, small_model.SPLITS, frames=60, points=80)
    small_model.write_params(tmp_path, epochs=1, seeds=[0, 1])
    networks = []
    for scheduler in ("", two_workers):
        monkeypatch.setenv(cluster.VARIABLE, scheduler)
        made = small_model.run_train(tmp_path)
        networks.append({name: content for name, content in contents(made).items() if name.endswith("best.pt")})
    assert networks[0].keys() == {"best.pt", "seed-1/best.pt"}
    assert networks[0] == networks[1]


@pytest.mark.slow
def test_a_scheduler_that_goes_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def kill(scheduler: subprocess.Popen[bytes]) -> None:
        wait_for((tmp_path / "here").exists)
        scheduler.kill()

    with started(tmp_path, 1) as dask:
        monkeypatch.setenv(cluster.VARIABLE, dask.address)
        killer = threading.Thread(target=kill, args=[dask.scheduler])
        killer.start()
        with pytest.raises(InputError, match=r"^the scheduler tcp://\S+ is gone: start it again, .*is kept$"):
            run(tmp_path, {"a5": "once"}, chained=True)
        killer.join()


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port: int = server.getsockname()[1]
    return port


@pytest.mark.parametrize(
    "address",
    [f"tcp://127.0.0.1:{free_port()}", "tcp://127.0.0.1", "here:8786", "tcp://x:y"],
    ids=["a port where nobody listens", "no port", "no scheme", "no number"],
)
def test_a_scheduler_that_nobody_reaches_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setenv(cluster.VARIABLE, address)
    with pytest.raises(InputError, match=rf"^STEER_SCHEDULER={address}: no scheduler answers there \(.*\)\. Start one"):
        run(tmp_path)
    monkeypatch.delenv(cluster.VARIABLE)
    run(tmp_path)


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(cluster.VARIABLE, "tcp://127.0.0.1:8786")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"^STEER_SCHEDULER is set, but .*: pip install '\.\[cluster\]'$"):
        run(tmp_path)
