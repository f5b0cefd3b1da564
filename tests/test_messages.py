"""Typical error messages as users read them: tests/messages.txt. Other tests check the fields of InputError.

python -m tests.test_messages    # writes the file anew after a change of messages; read its diff
"""

import contextlib
import errno
import os
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from pipeline.base import console, executors, runner, store
from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.lock import exclusive
from pipeline.base.params import load, load_entry
from pipeline.base.resume import ROOT, file_hash
from pipeline.camera.images import read_image
from pipeline.fitting import checkpoint
from pipeline.kitti import oxts
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.raw import find_drives, read_scan
from pipeline.sections import preset
from pipeline.sections.graphs import Variant
from pipeline.sections.labels import Labels
from tests import artefacts

SNAPSHOT = Path(__file__).with_name("messages.txt")
DRIVE = "2026_01_01_drive_0001"
PARAMS = Path("params.yaml")
LABELS = Path(f"data/labels/{DRIVE}.h5")
RAW = Path(f"data/raw/2026_01_01/{DRIVE}_sync")


def params(old: str, new: str) -> None:
    """Read the section labels of a params file with one change."""
    PARAMS.write_text((ROOT / "params.yaml").read_text().replace(old, new, 1))
    load(Labels, PARAMS)


def params_unknown_key() -> None:
    params("standstill:", "standstil:")


def params_out_of_range() -> None:
    params("wheelbase_m: 2.7", "wheelbase_m: -1")


def params_wrong_value() -> None:
    params("standstill: invalid", "standstill: never")


def params_without_section() -> None:
    params("labels:", "label:")


def params_invalid_yaml() -> None:
    params("labels:", "labels: [")


def params_unknown_entry() -> None:
    PARAMS.write_text((ROOT / "params.yaml").read_text())
    load_entry(Variant, "graphs", "semantik", PARAMS)


def params_missing() -> None:
    load(Labels, Path("params.yml"))


def preset_unknown() -> None:
    preset.merged("kiti")


def stage_input_missing() -> None:
    store.read_index(Path("data/labels"), stage="labels")


def drive_missing() -> None:
    with store.DriveReader(LABELS, stage="labels"):
        pass


def write_labels() -> None:
    artefacts.write_labels(LABELS, DRIVE, np.zeros(3), np.arange(3))


def drive_cut() -> None:
    write_labels()
    LABELS.write_bytes(LABELS.read_bytes()[:1000])
    drive_missing()


def drive_of_another_schema() -> None:
    write_labels()
    with h5py.File(LABELS, "r+") as file:
        file.attrs["schema"] = 1
    drive_missing()


def drive_of_another_stage() -> None:
    write_labels()
    with store.DriveReader(LABELS, stage="graphs"):
        pass


def dataset_missing() -> None:
    write_labels()
    with store.DriveReader(LABELS, stage="labels") as file:
        file["xyz"]


def packet_cut() -> None:
    path = RAW / "oxts/data/0000000003.txt"
    path.parent.mkdir(parents=True)
    path.write_text("49.0 8.4 112.8")
    oxts.read_row(path)


def scan_cut() -> None:
    path = RAW / "velodyne_points/data/0000000003.bin"
    path.parent.mkdir(parents=True)
    path.write_bytes(bytes(1001))
    read_scan(path)


def image_damaged() -> None:
    path = RAW / "image_02/data/0000000003.png"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(20))
    read_image(path, (375, 1242), (96, 320))


def calibration_missing() -> None:
    read_camera(RAW.parent, 2)


def raw_drive_missing() -> None:
    (RAW.parent / "2026_01_01_drive_0002_sync").mkdir(parents=True)
    find_drives(RAW.parents[1], [DRIVE])


def checkpoint_damaged() -> None:
    Path("best.pt").write_bytes(b"PK\x03\x04" + bytes(100))
    checkpoint.load(Path("best.pt"))


def hashed_file_missing() -> None:
    file_hash(LABELS)


def folder_locked() -> None:
    for _ in range(2):
        locks.enter_context(exclusive(Path("data/labels"), Path("data/.resume/labels")))


def lock_is_a_link() -> None:
    Path("data/.resume").mkdir(parents=True)
    Path("data/.resume/labels.lock").symlink_to("precious")
    folder_locked()


def workers_not_a_number() -> None:
    os.environ["STEER_WORKERS"] = "all"
    executors.default_workers()


def scheduler_not_running() -> None:
    os.environ["STEER_SCHEDULER"] = "tcp://127.0.0.1:1"
    list(runner.run_jobs(str, ["a", "b"]))


def fail(drive: str, path: Path) -> dict[str, object]:
    for _ in runner.progress.track([42]):
        raise DamagedFile("the file is cut short", RAW / "image_02/data/0000000042.png", "Extract it again")
    return {}


def frame_damaged() -> None:
    runner.run_over_drives(fail, [DRIVE], out=Path("data/ingest"), key=str, workers=1)


def worker_died() -> None:
    raise runner._worker_died(executors.BrokenExecutor(), [DRIVE])


def disk_full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(LABELS))


def ctrl_c() -> None:
    raise KeyboardInterrupt


CASES: list[Callable[[], None]] = [
    params_unknown_key, params_out_of_range, params_wrong_value, params_without_section, params_invalid_yaml,
    params_unknown_entry, params_missing, preset_unknown, stage_input_missing, drive_missing, drive_cut,
    drive_of_another_schema, drive_of_another_stage, dataset_missing, packet_cut, scan_cut, image_damaged,
    calibration_missing, raw_drive_missing, checkpoint_damaged, hashed_file_missing, folder_locked, lock_is_a_link,
    workers_not_a_number, scheduler_not_running, frame_damaged, worker_died, disk_full, ctrl_c,
]  # fmt: skip
locks = contextlib.ExitStack()


def render(case: Callable[[], None], folder: Path) -> str:
    """Return what the command line prints for a fault, with the name of the case."""
    environment, working_folder, handler = dict(os.environ), Path.cwd(), signal.getsignal(signal.SIGTERM)
    (folder / case.__name__).mkdir()
    os.chdir(folder / case.__name__)
    try:
        with (
            Path("stderr").open("w") as errors,
            Path("stdout").open("w") as output,
            contextlib.redirect_stderr(errors),
            contextlib.redirect_stdout(output),
            contextlib.suppress(SystemExit),
            locks,
        ):
            console.guarded(case)()
        return f"{case.__name__}\n  {Path('stderr').read_text().strip()}\n"
    finally:
        os.chdir(working_folder)
        os.environ.clear()
        os.environ.update(environment)
        signal.signal(signal.SIGTERM, handler)


def test_messages(tmp_path: Path) -> None:
    rendered = [render(case, tmp_path) for case in CASES]
    assert "\n".join(rendered) == SNAPSHOT.read_text()
    for text in rendered:
        name, *lines = text.splitlines()
        assert len(lines) == 1, f"{name}: expected one line"
        assert lines[0].startswith("  error: ")
        assert not lines[0].endswith(":")


def test_an_input_error_is_a_line_of_three_fields() -> None:
    error = InputError("the file is cut short", "a.png", "Extract it again")
    assert str(error) == "a.png: the file is cut short. Extract it again"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch_folder:
        SNAPSHOT.write_text("\n".join(render(case, Path(scratch_folder)) for case in CASES))
    sys.stdout.write(SNAPSHOT.read_text())
