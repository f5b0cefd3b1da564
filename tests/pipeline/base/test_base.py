"""HDF5 files, outputs and runs: files are complete however a run ends, and nothing else is lost."""

import errno
import fcntl
import json
import os
import resource
import shutil
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
import pytest

from pipeline.base import console, executors, keys, runner, store
from pipeline.base.errors import InputError
from pipeline.base.outputs import StageFolder, find_free, free_folder, stage_folder
from pipeline.base.store import DriveReader, DriveWriter, read_json
from tests import artefacts
from tests.artefacts import write_index
from tests.kitti_drive import contents
from tests.kitti_drive import write as write_text
from tests.pipeline.base import toy_stage
from tests.pipeline.base.toy_stage import DRIVES, alive, calls, outputs, start, trouble, wait_for

DRIVE = "2011_09_26_drive_0001"
# Numbers of points of the three frames in the file of write().
COUNTS = (5000, 0, 9000)
IMAGE = np.random.default_rng(0).integers(0, 256, (3, 8, 9, 3), np.uint8)
XYZ = [np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32) for count in COUNTS]


def write(path: Path) -> Path:
    with DriveWriter(path, stage="clouds", drive=DRIVE, params={"clouds": {"seed": 0}}) as file:
        file.attrs["split"] = "train"
        file.put("frame", np.array([0, 2, 3], np.int32))
        file.put("time_s", np.array([0.0, 0.2, 0.3]), "s")
        file.put("image", IMAGE, "RGB")
        file.append("cls", np.full((3, 8, 9), 7, np.uint8), "trainId")
        for xyz in XYZ:
            nearest = np.arange(len(xyz), dtype=np.int32)
            file.append("xyz", xyz, "m", "ptr")
            file.append("nearest", nearest, "row", "ptr")
        file.put_pointers("ptr", COUNTS)
    return path


def test_round_trip(tmp_path):
    with DriveReader(write(tmp_path / "a.h5"), stage="clouds") as file:
        assert file.drive == DRIVE
        assert file.attrs["split"] == "train"
        assert file.params == {"clouds": {"seed": 0}}
        np.testing.assert_array_equal(file.time_s, [0, 0.2, 0.3])
        np.testing.assert_array_equal(file["image"], IMAGE)
        np.testing.assert_array_equal(file.row("image", 2), IMAGE[2])
        np.testing.assert_array_equal(file["ptr"], [0, 5000, 5000, 14000])
        assert file.pointers == {"xyz": "ptr", "nearest": "ptr"}
        for row, points in enumerate(XYZ):
            np.testing.assert_array_equal(file.rows_of("xyz", row), points)
        assert (file["cls"] == 7).all()
        assert file.units["xyz"] == "m"
        assert [file.row_of(number) for number in (0, 2, 3)] == [0, 1, 2]
        with pytest.raises(InputError, match="no frame 1"):
            file.row_of(1)
        with pytest.raises(InputError, match=r"no dataset 'depth'.*cls, frame"):
            file["depth"]


def test_two_writes_are_byte_identical_and_an_error_changes_nothing(tmp_path):
    path = write(tmp_path / "a.h5")
    before = path.read_bytes()
    assert write(tmp_path / "b.h5").read_bytes() == before
    with (  # noqa: PT012
        pytest.raises(ZeroDivisionError),
        DriveWriter(path, stage="labels", drive=DRIVE, params={}) as file,
    ):
        file.put("frame", np.arange(1000))
        raise ZeroDivisionError
    assert contents(tmp_path) == dict.fromkeys(("a.h5", "b.h5"), before)


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let the system refuse files beyond `size` bytes by this process, as with a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_reported_instead_of_its_consequences(tmp_path):
    """HDF5 drops errors or raises its own, depending on when the disk is full."""
    rng = np.random.default_rng(0)
    for size in range(1000, 25_000, 2000):
        with (  # noqa: PT012
            pytest.raises(OSError, match=str(tmp_path / "a.h5")) as error,
            files_up_to(size),
            DriveWriter(tmp_path / "a.h5", stage="ingest", drive=DRIVE, params={}) as file,
        ):
            for _ in range(100):
                file.append("lidar", rng.random((100, 4), np.float32))
        assert error.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


def to_virtual(file: h5py.File, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((3, 8, 9, 3), np.uint8)
    layout[:] = h5py.VirtualSource(elsewhere, "image", (3, 8, 9, 3))
    file.create_virtual_dataset("image", layout)


def to_link(file: h5py.File, elsewhere: Path) -> None:
    file["image"] = h5py.ExternalLink(elsewhere, "image")


def to_external(file: h5py.File, elsewhere: Path) -> None:
    storage = [(elsewhere, 0, h5py.h5f.UNLIMITED)]
    file.create_dataset("image", (16,), np.uint8, external=storage)


def to_other_filter(file: h5py.File, _: Path) -> None:
    file.create_dataset("image", data=IMAGE, **hdf5plugin.Blosc2())


@pytest.mark.parametrize("change", [to_virtual, to_link, to_external, to_other_filter])
def test_a_file_from_elsewhere_opens_no_other_file_and_runs_no_filter_of_others(tmp_path, change):
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        del file["image"]
        change(file, write(tmp_path / "elsewhere.h5"))
    problem = "'image' (is a link|has external storage or a filter)"
    with pytest.raises(InputError, match=problem) as raised:
        DriveReader(path, stage="clouds")
    assert raised.value.where == str(path)


def edit_attributes(path: Path, **attributes: Any) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


def in_folder_of_stage(path: Path) -> None:
    path.with_name("index.json").touch()


@pytest.mark.parametrize(
    ("stage", "change", "problem"),
    [
        ("ingest", None, "expected a file of stage ingest; got stage clouds"),
        ("clouds", Path.unlink, "missing"),
        ("clouds", in_folder_of_stage, f"contains drive {DRIVE}"),
        ("clouds", partial(edit_attributes, schema=3), "expected schema 7 or 8; got 3"),
        ("graphs", partial(edit_attributes, stage="graphs", schema=7), "expected schema 8; got 7"),
        ("clouds", partial(edit_attributes, params="{"), "damaged in its settings"),
        ("clouds", cut_short, "damaged"),
    ],
)
def test_files_of_other_stages_schemas_and_drives_are_refused(tmp_path, stage, change, problem):
    path = write(tmp_path / "a.h5")
    if change:
        change(path)
    with pytest.raises(InputError, match=problem) as raised:
        DriveReader(path, stage=stage)
    assert raised.value.where == str(path)
    assert f"dvc repro {stage}" in raised.value.fix


def write_each_stage(folder: Path) -> None:
    """Write a small file of each stage."""
    frame = np.arange(8)
    angles_rad = np.linspace(-0.1, 0.1, 8)
    write(folder / "clouds.h5")
    artefacts.write_recorded(folder / "ingest.h5", frame, oxts=np.ones((8, 30)))
    artefacts.write_motion(folder, "motion", dict.fromkeys(range(8), (8.0, 0.1)))
    artefacts.write_labels(folder / "labels.h5", angles_rad, frame)
    artefacts.write_graphs(folder / "graphs.h5", angles_rad, frame, points=50)
    path = folder / "perception.h5"
    with DriveWriter(path, stage="perception", drive="drive", params={"batch": 4}) as file:
        # HDF5 keeps more than eight attributes in another structure.
        for number in range(20):
            file.attrs[f"count_{number}"] = number
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame / 10, "s")


def read(path: Path) -> dict[str, Any]:
    """Return all values, texts and settings of a file."""
    with DriveReader(path, stage=None) as file:
        content = {name: (file[name].tobytes(), file.units[name]) for name in file.datasets}
        names = {"pointers": file.pointers}
        return content | file.attrs | names | {"params": file.params}


def test_a_wrong_bit_in_a_file_is_never_another_value(tmp_path):
    """Equal values come from unused bytes."""
    rng = np.random.default_rng(0)
    write_each_stage(tmp_path)
    paths = sorted(tmp_path.iterdir())
    assert [path.stem for path in paths] == sorted(store.SCHEMAS)
    for path in paths:
        content = path.read_bytes()
        expected = read(path)
        settings = json.dumps(expected["params"], sort_keys=True).encode()
        places = rng.integers(len(content), size=40)
        places[:8] = content.index(settings) + rng.integers(len(settings), size=8)
        refused = 0
        for place in places.tolist():
            damaged = bytearray(content)
            damaged[place] ^= 1 << rng.integers(8)
            path.write_bytes(damaged)
            try:
                assert read(path) == expected
            except InputError:
                refused += 1
        assert refused > len(places) / 2, path.name


def test_reading_needs_no_lock(tmp_path):
    """Some disks have none."""
    path = write(tmp_path / "a.h5")
    with path.open() as descriptor:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with DriveReader(path, stage="clouds") as file:
            assert file.drive == DRIVE


def test_an_index_keeps_its_order_and_names_missing_files(tmp_path):
    splits = {"b": "train", "a": "test", "c": "train"}
    write_index(tmp_path, splits)
    with pytest.raises(InputError, match=r"no file for b, a, c.*dvc repro clouds"):
        store.read_index(tmp_path, stage="clouds")
    for drive in splits:
        write(tmp_path / f"{drive}.h5")
    index = store.read_index(tmp_path, stage="clouds")
    assert [*index.items()] == [*splits.items()]
    assert store.drives_in(splits, "train") == ["b", "c"]


def write_stage(out: Path, *files: str) -> None:
    with stage_folder("labels", out, {"a": "train"}) as folder:
        for file in files:
            write_text(folder.new / file, file)


def test_a_stage_replaces_its_files_and_drives_that_are_no_more(tmp_path):
    out = tmp_path / "data/labels"
    write_stage(out, "a.h5", "old.h5", "below/old.txt")
    write_text(out / "own.txt", "foreign")
    before = contents(out)
    with pytest.raises(ZeroDivisionError), stage_folder("labels", out) as folder:  # noqa: PT012
        write_text(folder.new / "b.h5", "half")
        raise ZeroDivisionError
    # As pandas and matplotlib raise it, without a path.
    with pytest.raises(OSError, match=str(out)), stage_folder("labels", out):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        stage_folder("labels", out),
        pytest.raises(InputError, match="another process"),
        stage_folder("labels", out),
    ):
        assert contents(out) == before
    write_stage(out, "a.h5", "b.h5", "below/new.txt")
    assert read_json(out / "index.json", stage="labels") == {"drives": {"a": "train"}}
    assert {*contents(out)} == {"a.h5", "b.h5", "below/new.txt", "own.txt", "index.json"}


def test_a_folder_that_no_stage_wrote_is_refused_unless_dvc_runs(tmp_path, monkeypatch):
    """DVC has emptied its outputs, but files of others may lie beside them."""
    out = tmp_path / "data/out"
    write_text(out / "notes.txt", "foreign")
    with pytest.raises(InputError, match=r"exists already and holds notes\.txt"):
        write_stage(out, "b.h5")
    monkeypatch.setenv("DVC_STAGE", "labels")
    write_stage(out, "b.h5")
    assert contents(out)["notes.txt"] == b"foreign"


@pytest.mark.parametrize(
    ("existing", "expected"),
    [([], "ride"), (["ride/poses.txt", "ride-2/.hidden"], "ride-3"), (["ride"], "ride-2")],
)
def test_a_command_takes_the_first_free_folder(tmp_path, monkeypatch, existing, expected):
    monkeypatch.chdir(tmp_path)
    for name in existing:
        write_text(Path("out") / name, "foreign")
    assert find_free(None, "ride", "") == Path("out") / expected
    with free_folder(None, "ride") as folder, free_folder(None, "ride") as second:
        assert folder == Path("out") / expected
        assert second != folder, "of two commands at once"
        write_text(second / "motion.csv", "result")
    assert not folder.exists()
    assert [path.name for path in second.iterdir()] == ["motion.csv"]


@pytest.fixture
def folder(tmp_path) -> Path:
    return toy_stage.prepare(tmp_path)


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict[str, bytes]:
    """The files that one process writes."""
    folder = toy_stage.prepare(tmp_path_factory.mktemp("serial"))
    toy_stage.main(folder, workers=1)
    return outputs(folder)


@pytest.mark.parametrize(("quota", "workers"), [("50000 100000", 1), ("max 100000", None)])
def test_a_container_has_as_many_workers_as_its_quota_allows(tmp_path, monkeypatch, quota, workers):
    monkeypatch.delenv("STEER_WORKERS")
    (tmp_path / "cpu.max").write_text(f"{quota}\n")
    monkeypatch.setattr(executors, "CPU_MAX", tmp_path / "cpu.max")
    assert executors.default_workers() == (workers or executors.usable_cores())
    monkeypatch.delattr("os.sched_getaffinity", raising=False)  # as on macOS and Windows
    assert executors.usable_cores() == os.cpu_count()


def test_only_what_changed_is_made_again(folder, expected, monkeypatch):
    """Finished drives stay, although DVC deletes the output of a stage before it runs."""
    for drives, k, input_b, code, made in [
        (["a", "b"], 2, bytes(6), "1", ["a", "b"]),
        (["a", "b", "c"], 2, bytes(6), "1", ["c"]),  # a new drive
        (["a", "b", "c"], 2, b"other", "1", ["b"]),
        (["a", "b", "c"], 3, b"other", "1", ["a", "b", "c"]),
        (["a", "b"], 3, b"other", "2", ["a", "b"]),
        (DRIVES, 2, bytes(6), "2", DRIVES),
        (DRIVES, 2, bytes(6), "2", []),
    ]:
        shutil.rmtree(folder / "data/toy", ignore_errors=True)
        (folder / "input/b").write_bytes(input_b)
        monkeypatch.setattr(keys.Code, "hash", lambda self, code=code: code)
        toy_stage.main(folder, k=k, workers=1, drives=drives)
        assert calls(folder) == made
    assert outputs(folder) == expected
    kept = [path.name.split("-")[0] for path in (folder / "data/.drives/toy").iterdir()]
    assert sorted(kept) == DRIVES, "without the drives of other settings"


@pytest.mark.parametrize(
    ("kind", "workers"),
    [("fail", 1), pytest.param("die", 2, marks=pytest.mark.slow)],
)
def test_an_error_and_a_dead_worker_keep_finished_drives(folder, expected, kind, workers):
    trouble(folder, c=kind)
    with pytest.raises(InputError) as raised:
        toy_stage.main(folder, workers=workers)
    if kind == "fail":
        assert raised.value.where == "c: 0.png"
    else:
        assert "STEER_WORKERS=1" in raised.value.fix
    assert outputs(folder) == {}, "the stage's folder is filled at the end"
    trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    repeated = calls(folder)
    assert "c" in repeated
    assert "b" not in repeated or kind == "die"
    assert outputs(folder) == expected


@pytest.mark.slow
def test_an_edit_before_a_process_of_the_stage_starts_is_named(folder, monkeypatch):
    monkeypatch.setitem(keys.LOADED, "numpy", "before the edit")
    with pytest.raises(InputError, match="numpy: was edited while stage labels ran"):
        toy_stage.main(folder, workers=2)
    assert calls(folder) == []


def test_a_drive_that_another_worker_has_just_finished_is_taken(tmp_path):
    """A worker of a cluster ends its drive after the run was interrupted, and repeated."""
    finished = {"frames": 9}

    def work(path: Path) -> dict[str, Any]:
        write_text(path, "mine")
        write_text(tmp_path / "kept/a.h5", "of the other worker")
        write_text(tmp_path / "kept/summary.json", json.dumps(finished))
        return {"frames": 1}

    summary, _ = runner._make_result(runner.Task("a", tmp_path / "kept/a.h5", work))
    assert summary == finished
    assert (tmp_path / "kept/a.h5").read_text() == "of the other worker"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_keeps_finished_drives_and_leaves_no_process(folder, expected, number):
    trouble(folder, a="wait", c="wait")
    with start(folder) as process:
        paths = [folder / f"trouble/{drive} waits" for drive in "ac"]
        wait_for(lambda: all(path.exists() and path.read_text() for path in paths))
        pids = [int(path.read_text()) for path in paths]
        wait_for(lambda: any((folder / "data/.drives/toy").glob("b-*")))
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal sends Ctrl-C
        else:
            process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode
    if number == signal.SIGINT:
        assert errors.startswith("error: interrupted")
        assert errors.count("\n") == 1
    wait_for(lambda: not any(alive(pid) for pid in pids))
    assert outputs(folder) == {}
    trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    assert "b" not in calls(folder)
    assert outputs(folder) == expected


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Start a scheduler and two workers."""
    distributed = pytest.importorskip("distributed")
    options = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1", "processes": True}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **options) as started:
        yield started


@pytest.fixture
def dask(cluster, monkeypatch) -> Any:
    monkeypatch.setenv(executors.SCHEDULER, cluster.scheduler_address)
    return cluster


@pytest.mark.slow
def test_a_worker_of_a_cluster_with_other_code_or_data_is_refused(folder, dask):
    import distributed

    with distributed.Client(dask, set_as_default=False) as client:
        client.wait_for_workers(2)  # an earlier test may have killed them
        client.run(toy_stage.pretend, "another")
        with pytest.raises(InputError, match="got another, expected") as raised:
            toy_stage.main(folder)
        client.run(toy_stage.pretend, keys.LOADED["numpy"])
    assert socket.gethostname() in raised.value.where
    assert calls(folder) == []

    stage = StageFolder(keys.Code.read("labels"), folder / "elsewhere/new", folder, set())
    with pytest.raises(InputError, match="data is the same as here"):
        next(executors.run_jobs(len, ["a", "b"], stage))


@pytest.mark.slow
def test_a_cluster_writes_the_bytes_of_one_process(folder, expected, dask):
    """A job of a dead worker is repeated."""
    trouble(folder, b="die once")
    toy_stage.main(folder)
    pids = {line.split()[1] for line in (folder / "calls").read_text().splitlines()}
    assert str(os.getpid()) not in pids
    assert outputs(folder) == expected


@pytest.mark.slow
def test_a_job_that_kills_workers_of_a_cluster_is_given_up(folder, dask, monkeypatch):
    """No test follows that needs workers: on a busy machine, they may not come back."""
    trouble(folder, b="die")
    monkeypatch.setattr(dask.scheduler, "allowed_failures", 1)
    with pytest.raises(InputError, match="a worker process died"):
        toy_stage.main(folder)


def test_without_a_scheduler_a_line_says_so(folder, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setenv(executors.SCHEDULER, "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match=r"no scheduler answers at .*Start one: dask scheduler"):
        toy_stage.main(folder)


def test_the_hash_of_a_folder_ignores_files_of_file_managers(tmp_path):
    write_text(tmp_path / "1.png", "a")
    expected = keys.digest({"1.png": keys.file_hash(tmp_path / "1.png")})
    for name in (".DS_Store", "._1.png"):
        write_text(tmp_path / name, "b")
        assert keys.content_hash(tmp_path) == expected
    write_text(tmp_path / "2.png", "a")
    assert keys.content_hash(tmp_path) != expected


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("wrong:\n  value", "a", "Do b"), "a: wrong: value. Do b"),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), "data/x.h5: No space left"),
        (KeyboardInterrupt(), "interrupted. Repeat the command"),
    ],
    ids=repr,
)
def test_errors_are_one_line_and_a_status(monkeypatch, error, line):
    def main() -> None:
        raise error

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(main)
    # Python prints it to stderr and exits with status 1.
    assert str(end.value.code).startswith(f"error: {line}")
