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
from functools import partial
from pathlib import Path
from unittest import mock

import h5py
import numpy as np

from pipeline.base import console, executors, runner, store
from pipeline.base.atomic import exclusive
from pipeline.base.errors import DamagedFile, named_frames
from pipeline.base.params import load, load_entry
from pipeline.base.resume import ROOT, file_hash
from pipeline.camera.images import read_image
from pipeline.fitting import checkpoint
from pipeline.kitti import oxts
from pipeline.kitti.raw import find_drives, read_calibration, read_scan
from pipeline.settings import preset
from pipeline.settings.graphs import Variant
from pipeline.settings.labels import Labels
from tests import artefacts

SNAPSHOT = Path(__file__).with_name("messages.txt")
DRIVE = "2026_01_01_drive_0001"
PARAMS = Path("params.yaml")
LABELS = Path(f"data/labels/{DRIVE}.h5")
RAW = Path(f"data/raw/2026_01_01/{DRIVE}_sync")


def changed_params(old: str, new: str) -> bytes:
    return (ROOT / "params.yaml").read_text().replace(old, new, 1).encode()


def read_drive(path: Path, stage: str = "labels", dataset: str = "frame") -> None:
    with store.DriveReader(path, stage=stage) as file:
        file[dataset]


def find_drive(path: Path) -> None:
    find_drives(Path("data/raw"), [DRIVE])


# What a reader is given: path, content (None: no file), reader.
FILES: dict[str, tuple[Path, bytes | None, Callable[[Path], object]]] = {
    "params_unknown_key": (PARAMS, changed_params("standstill:", "standstil:"), partial(load, Labels)),
    "params_out_of_range": (PARAMS, changed_params("wheelbase_m: 2.7", "wheelbase_m: -1"), partial(load, Labels)),
    "params_wrong_value": (PARAMS, changed_params("standstill: invalid", "standstill: never"), partial(load, Labels)),
    "params_without_section": (PARAMS, changed_params("labels:", "label:"), partial(load, Labels)),
    "params_invalid_yaml": (PARAMS, b"clouds: {}\nlabels: [\n  a: 1\nb: 2\n", partial(load, Labels)),
    "params_unknown_entry": (PARAMS, changed_params("", ""), partial(load_entry, Variant, "graphs", "semantik")),
    "params_missing": (Path("params.yml"), None, partial(load, Labels)),
    "stage_input_missing": (Path("data/labels"), None, partial(store.read_index, stage="labels")),
    "drive_missing": (LABELS, None, read_drive),
    "drive_without_header": (LABELS, bytes(1000), read_drive),
    "packet_cut": (RAW / "oxts/data/0000000003.txt", b"49.0 8.4 112.8", oxts.read_row),
    "scan_cut": (RAW / "velodyne_points/data/0000000003.bin", bytes(1001), read_scan),
    "image_damaged": (
        RAW / "image_02/data/0000000003.png",
        b"\x89PNG\r\n\x1a\n" + bytes(20),
        partial(read_image, size=(375, 1242), new_size=(96, 320)),
    ),
    "calibration_missing": (RAW.parent, None, partial(read_calibration, number=2)),
    "raw_drive_missing": (RAW.parent / "2026_01_01_drive_0002_sync/oxts", b"", find_drive),
    "checkpoint_damaged": (Path("best.pt"), b"PK\x03\x04" + bytes(100), checkpoint.load),
    "hashed_file_missing": (LABELS, None, file_hash),
}


def read(path: Path, content: bytes | None, reader: Callable[[Path], object]) -> None:
    if content is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    reader(path)


def preset_unknown() -> None:
    Path("presets").mkdir()
    for name in ("kitti", "real"):
        Path(f"presets/{name}.yaml").touch()
    with mock.patch.object(preset, "PRESETS", Path("presets")):  # a user may have added some
        preset.merged("kiti")


def write_labels() -> None:
    artefacts.write_labels(LABELS, DRIVE, np.zeros(3), np.arange(3))


def drive_of_another_schema() -> None:
    write_labels()
    with h5py.File(LABELS, "r+") as file:
        file.attrs["schema"] = 1
    read_drive(LABELS)


def drive_of_another_stage() -> None:
    write_labels()
    read_drive(LABELS, stage="graphs")


def dataset_missing() -> None:
    write_labels()
    read_drive(LABELS, dataset="xyz")


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


def fail(path: Path) -> dict[str, object]:
    for _ in named_frames([42]):
        raise DamagedFile("the file is cut short", RAW / "image_02/data/0000000042.png", "Extract it again")
    return {}


def frame_damaged() -> None:
    out = Path("data/ingest")
    with runner.run_over_drives("ingest", {}, [runner.Job(DRIVE, out / f"{DRIVE}.h5", [], fail)], out, workers=1):
        pass


def worker_died() -> None:
    raise runner._worker_died([DRIVE])


def disk_full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(LABELS))


def ctrl_c() -> None:
    raise KeyboardInterrupt


OTHERS = (
    preset_unknown, drive_of_another_schema, drive_of_another_stage, dataset_missing, folder_locked, lock_is_a_link,
    workers_not_a_number, scheduler_not_running, frame_damaged, worker_died, disk_full, ctrl_c,
)  # fmt: skip
CASES: dict[str, Callable[[], None]] = {name: partial(read, *case) for name, case in FILES.items()}
CASES |= {case.__name__: case for case in OTHERS}
locks = contextlib.ExitStack()


def render(name: str, folder: Path) -> str:
    """Return what the command line prints for a fault, with the name of the case."""

    def run() -> None:  # guarded needs a function with a name
        CASES[name]()

    environment, working_folder, handler = dict(os.environ), Path.cwd(), signal.getsignal(signal.SIGTERM)
    (folder / name).mkdir()
    os.chdir(folder / name)
    try:
        with (
            Path("stderr").open("w") as errors,
            Path("stdout").open("w") as output,
            contextlib.redirect_stderr(errors),
            contextlib.redirect_stdout(output),
            contextlib.suppress(SystemExit),
            locks,
        ):
            console.guarded(run)()
        return f"{name}\n  {Path('stderr').read_text().strip()}\n"
    finally:
        os.chdir(working_folder)
        os.environ.clear()
        os.environ.update(environment)
        signal.signal(signal.SIGTERM, handler)


def test_messages(tmp_path: Path) -> None:
    rendered = [render(name, tmp_path) for name in CASES]
    assert "\n".join(rendered) == SNAPSHOT.read_text()
    for text in rendered:
        name, *lines = text.splitlines()
        assert len(lines) == 1, f"{name}: expected one line"
        assert lines[0].startswith("  error: ")
        assert not lines[0].endswith(":")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch_folder:
        SNAPSHOT.write_text("\n".join(render(name, Path(scratch_folder)) for name in CASES))
    sys.stdout.write(SNAPSHOT.read_text())
